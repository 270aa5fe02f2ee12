"""Run a depth network on a photo; its depth has the network's own unit and size."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import numpy.typing as npt

from ltm_core.base.errors import ImageError, ModelError
from ltm_core.base.types import Float32Array, Float64Array, UInt8Array
from ltm_core.depth.fusion_config import load_fusion_config
from ltm_core.geometry.camera import Camera
from ltm_core.vision.manifest import DepthKind, NetworkManifest
from ltm_core.vision.network_image import as_tensor, fitted, pixel_rays, scaled_matrix
from ltm_core.vision.onnx_model import OnnxModel

_ROUNDS: Final = 100
"""Maximum rounds of reweighting of the shift of 3-D points; real ones take about 5."""


@dataclass(frozen=True, eq=False)
class NetworkDepth:
    """Depth of a network over the whole field of view of the photo, edge to edge.

    `values`: (h, w) float32 at any size. Of kind `relative_inverse`: inverse depth but for a scale and a shift;
    `affine_invariant`: depth but for a scale and a shift; `metric`: metres along the optical axis. NaN: no answer."""

    values: Float32Array
    kind: DepthKind

    def __post_init__(self) -> None:
        values = np.ascontiguousarray(self.values, np.float32)
        if values.ndim != 2 or min(values.shape) < 2:
            raise ImageError(f"network depth must be an image of 2 x 2 or more numbers, got shape {values.shape}")
        object.__setattr__(self, "values", values)


class DepthNetwork:
    """Runs the depth network of a manifest on RGB photos of any size. `threads`: CPU threads of ONNX Runtime. Raises
    ModelError as OnnxModel, and for a network of labels; ConfigError for an invalid file of constants."""

    def __init__(self, manifest: NetworkManifest, threads: int = 1) -> None:
        self.manifest = manifest.require(depth=True)
        self._model = OnnxModel(manifest, threads)
        self.fusion = load_fusion_config(manifest)

    @classmethod
    def open(cls, path_or_name: str | Path, threads: int = 1) -> "DepthNetwork":
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
        photo = fitted(rgb, self.manifest.input)
        size, output = rgb.shape[:2], self.manifest.output
        matrix = scaled_matrix(camera.matrix, size, (photo.rows, photo.cols))
        main, *beside = self._model.outputs(as_tensor(photo.pixels, self.manifest.input), matrix)
        found = dict(zip(output.beside, beside, strict=True))
        planes = depth_planes(main, output.layout)
        if planes is None:
            raise ModelError(
                f"model {self.manifest.name!r}: its depth has shape {main.shape}, expected a depth or a 3-D point per "
                "pixel"
            )
        planes = photo.without_padding(planes)
        values = np.array(planes[-1], np.float32)
        values[~np.isfinite(values)] = np.nan
        if output.valid is not None:
            valid = depth_planes(found[output.valid], output.layout)
            if valid is None or photo.without_padding(valid).shape[1:] != values.shape:
                raise ModelError(f"model {self.manifest.name!r}: its {output.valid} has another size than its depth")
            # A probability of 0.5 and more, or a logit above 0.
            limit = 0.5 if valid.min() >= 0.0 and valid.max() <= 1.0 else 1e-6
            values[photo.without_padding(valid)[0] < limit] = np.nan
        if output.metre_scale is not None:
            rays = pixel_rays(scaled_matrix(camera.matrix, size, values.shape), values.shape)[:2]
            values += np.float32(shift_of_points(planes, values, rays))
            values *= np.float32(self._number(output.metre_scale, found))
        if output.kind == "metric":
            values = self._metres(values, matrix, found, photo.pixels.shape[1])
        return NetworkDepth(values, cast(DepthKind, output.kind))

    def _metres(
        self, values: Float32Array, matrix: Float64Array, found: dict[str, npt.NDArray[Any]], width: int
    ) -> Float32Array:
        """Return metres along the optical axis. Focal lengths are horizontal ones: if a photo is stretched, networks
        know the width of their view (Depth Pro)."""
        output = self.manifest.output
        with np.errstate(divide="ignore", invalid="ignore"):
            metres = np.where(values > 0, values, np.nan)
            metres = 1.0 / metres if output.inverse else metres
        assumed = output.canonical_focal_px
        if output.focal is not None:
            assumed = self._number(output.focal, found)
            if "fov" in output.focal.lower():
                angle = np.radians(assumed) if assumed > np.pi else assumed
                assumed = width / 2.0 / float(np.tan(angle / 2.0))
        if assumed is not None:
            metres = metres * (matrix[0, 0] / assumed)
        return metres.astype(np.float32)

    def _number(self, name: str, found: dict[str, npt.NDArray[Any]]) -> float:
        """Return the one positive number of an output. Raises ModelError for others."""
        value = found[name]
        if value.size != 1 or not np.isfinite(value).all() or value.min() <= 0.0:
            given = value.ravel()[:4].tolist()
            raise ModelError(f"model {self.manifest.name!r}: its {name} is {given}; expected one positive number")
        return float(value.reshape(()))


def depth_planes(output: npt.NDArray[Any], layout: str) -> Float32Array | None:
    """Return a network's depth (1, h, w), or its 3-D points (3, h, w); None for another shape."""
    shape = [size for axis, size in enumerate(output.shape) if size != 1 or axis >= output.ndim - 2]
    planes = output.reshape(shape)
    if planes.ndim == 3 and planes.shape[-1] in (1, 3) and (layout == "NHWC" or planes.shape[0] != 3):
        planes = np.moveaxis(planes, -1, 0)
    planes = planes[None] if planes.ndim == 2 else planes
    return np.asarray(planes, np.float32) if planes.ndim == 3 and len(planes) in (1, 3) else None


def shift_of_points(points: Float32Array, depth: Float32Array, rays: Float64Array) -> float:
    """Return the shift along the optical axis that brings 3-D points (3, h, w) of unknown shift onto a camera's rays.

    `depth`: their third plane (h, w), NaN where it does not count. `rays` (2, h, w): x and y at depth 1. The image
    residual of x = ray (z + shift) is minimised, reweighted by the depth (Wang et al., MoGe, CVPR 2025, with a known
    focal length)."""
    known = np.isfinite(depth) & np.isfinite(points).all(axis=0)
    if not known.any():
        return 0.0
    ray, xy, z = rays[:, known], points[:2, known].astype(np.float64), depth[known].astype(np.float64)
    nearest, shift = max(1e-6, 1e-3 * float(np.median(np.abs(z)))), 0.0
    for _ in range(_ROUNDS):
        weight, before = 1.0 / np.maximum(z + shift, nearest) ** 2, shift
        shift = float((weight * ray * (xy - ray * z)).sum() / (weight * ray * ray).sum())
        if abs(shift - before) <= 1e-7 * abs(shift):
            break
    return shift
