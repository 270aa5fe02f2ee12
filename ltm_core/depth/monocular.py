"""Run a depth network on a photo; its depth has the network's own unit and size."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import numpy as np

from ltm_core.base.errors import ImageError, ModelError
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.depth.fusion_config import load_fusion_config
from ltm_core.geometry.camera import Camera
from ltm_core.vision.manifest import DEPTH_KINDS, NetworkManifest
from ltm_core.vision.onnx_model import OnnxModel, input_tensor

DepthKind = Literal["relative_inverse", "affine_invariant", "metric"]


@dataclass(frozen=True, eq=False)
class NetworkDepth:
    """Depth of a network over the whole field of view of the photo, edge to edge.

    `values`: (h, w) float32 at any size. Of kind `relative_inverse`: inverse depth but for a scale and a shift;
    `affine_invariant`: depth but for a scale and a shift; `metric`: metres along the optical axis. NaN: no answer.
    """

    values: Float32Array
    kind: DepthKind

    def __post_init__(self) -> None:
        if self.kind not in DEPTH_KINDS:
            raise ImageError(f"network depth of kind {self.kind!r}; supported kinds: {', '.join(DEPTH_KINDS)}")
        values = np.ascontiguousarray(self.values, np.float32)
        if values.ndim != 2 or min(values.shape) < 2:
            raise ImageError(f"network depth must be an image of 2 x 2 or more numbers, got shape {values.shape}")
        object.__setattr__(self, "values", values)


class DepthNetwork:
    """Runs the depth network of a manifest on RGB photos of any size. `threads`: CPU threads of ONNX Runtime. Raises
    ModelError as OnnxModel, and for a network of labels; ConfigError for an invalid file of constants."""

    def __init__(self, manifest: NetworkManifest, threads: int = 1) -> None:
        if not manifest.output.is_depth:
            raise ModelError(
                f"model {manifest.name!r} outputs {manifest.output.kind} of labels, not depth; "
                f"a depth model's output is one of {', '.join(DEPTH_KINDS)}"
            )
        self.manifest = manifest
        self._model = OnnxModel(manifest, threads)
        self.fusion = load_fusion_config(manifest)

    @classmethod
    def open(cls, path_or_name: str | Path, threads: int = 1) -> DepthNetwork:
        """Return a network by its manifest's path, or by the name of one in `config/models`."""
        return cls(NetworkManifest.find(path_or_name), threads)

    def predict(self, rgb: UInt8Array, camera: Camera) -> NetworkDepth:
        """Return the depth of a photo (H, W, 3) uint8 RGB taken by `camera`, NaN where invalid; metres of a network for
        one focal length are scaled to the camera's. Raises ImageError for another shape, size or dtype."""
        if rgb.shape != (camera.height, camera.width, 3) or rgb.dtype != np.uint8:
            raise ImageError(
                f"photo of {rgb.shape} {rgb.dtype} does not fit a camera of {camera.width} x {camera.height}: "
                f"expected ({camera.height}, {camera.width}, 3) uint8 RGB"
            )
        spec = self.manifest.input
        across, down = spec.width / camera.width, spec.height / camera.height
        # Edge to edge: pixel centres move by half a pixel when the image is resized.
        matrix = np.array(
            [
                [camera.fx * across, 0.0, (camera.cx + 0.5) * across - 0.5],
                [0.0, camera.fy * down, (camera.cy + 0.5) * down - 0.5],
                [0.0, 0.0, 1.0],
            ],
            np.float32,
        )
        output = self._model.run(input_tensor(rgb, spec), matrix if spec.intrinsics is not None else None)
        values = np.squeeze(output)
        if values.ndim != 2:
            raise ModelError(
                f"model {self.manifest.name!r}: its depth has shape {output.shape}, expected one number a pixel"
            )
        values = np.array(values, np.float32)
        values[~np.isfinite(values)] = np.nan
        kind = cast(DepthKind, self.manifest.output.kind)
        if kind == "metric":
            values = self._metres(values, float(np.sqrt(matrix[0, 0] * matrix[1, 1])))
        return NetworkDepth(values, kind)

    def _metres(self, values: Float32Array, focal_px: float) -> Float32Array:
        """`focal_px`: of the network's input; its two axes may be stretched differently, so their geometric mean."""
        output = self.manifest.output
        with np.errstate(divide="ignore", invalid="ignore"):
            metres = np.where(values > 0, values, np.nan)
            metres = 1.0 / metres if output.inverse else metres
        if output.canonical_focal_px is not None:
            metres = metres * (focal_px / output.canonical_focal_px)
        return metres.astype(np.float32)
