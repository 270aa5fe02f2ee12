"""Reads folders of depth maps from other sources, such as UniDepth, Depth Pro, Depth Anything or a lidar."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from ltm_core.base.errors import ImageError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float32Array
from ltm_core.geometry.camera import Camera
from ltm_core.raster.raster_io import check_size, open_raster
from ltm_core.storage.config_io import load_yaml
from ltm_core.storage.photo_io import check_picture
from ltm_core.storage.text_io import load_array
from ltm_lab.evaluation.metrics.depth_fit import DepthKind

SUFFIXES = (".npy", ".png", ".tif", ".tiff")
CONFIG = "depth_maps.yaml"
_LARGEST = 512 << 20
"""Bytes of an .npy file."""


class DepthMapsConfig(StrictModel):
    """What the numbers in a folder mean: `depth_maps.yaml` in it; all keys may be left out but for 16-bit PNG."""

    kind: DepthKind = "metric"
    along: Literal["axis", "ray"] = "axis"
    """Metres along the optical axis (z), or along each pixel's ray."""
    metres_per_unit: float | None = Field(None, gt=0)
    """Metres that 1 stands for; needed for integers (millimetres: 0.001). Integer 0 is unknown."""

    @model_validator(mode="after")
    def _ranges_are_metres(self) -> Self:
        if self.along == "ray" and self.kind != "metric":
            raise ValueError(f"along: ray needs kind: metric; depth of kind {self.kind} cannot be turned to the axis")
        return self


@dataclass(frozen=True)
class DepthMapFolder:
    """Depth maps named `<camera>/<stamp in ns>.npy` or `<camera>_<stamp in ns>.npy`; also .png (16 bit), .tif."""

    name: str
    path: Path
    config: DepthMapsConfig

    @classmethod
    def open(cls, name: str, path: Path) -> DepthMapFolder:
        """Raises ImageError where the folder holds no depth map, ConfigError on a wrong depth_maps.yaml."""
        if not path.is_dir():
            raise ImageError(f"{path}: no such folder")
        if not any(file.suffix in SUFFIXES for file in path.rglob("*")):
            raise ImageError(f"{path} holds no depth map: name them CAMERA/STAMP_NS.npy, .png or .tif")
        config = load_yaml(path / CONFIG, DepthMapsConfig) if (path / CONFIG).is_file() else DepthMapsConfig()
        return cls(name, path, config)

    def of_frame(
        self, camera_name: str, stamp_ns: int, image: tuple[int, int], camera: Camera | None
    ) -> Float32Array | None:
        """The map of a frame whose image has `image` (rows, columns): (h, w) in the folder's own kind, along the
        optical axis, NaN unknown; None where there is none.

        `camera` turns ranges along rays to the axis. Raises ImageError on a file that is no image of one channel, that
        lies on its side, on integers without a unit, and on ranges without a camera.
        """
        file = self._file(camera_name, stamp_ns)
        if file is None:
            return None
        depth = self._load(file)
        rows, cols = depth.shape
        turned = abs(math.log(cols / rows * image[1] / image[0])) < 0.02 < 0.1 < abs(math.log(image[1] / image[0]))
        if turned:
            raise ImageError(f"{file}: {rows} rows of {cols} lie on their side; the image has {image[0]} of {image[1]}")
        if self.config.along == "axis":
            return depth
        if camera is None:
            raise ImageError(f"{self.path} gives ranges along rays, but nothing says the camera to turn them by")
        cosine = camera.rays()[..., 2].astype(np.float32)
        at_rows = ((np.arange(rows) + 0.5) * camera.height / rows).astype(np.int64)
        at_cols = ((np.arange(cols) + 0.5) * camera.width / cols).astype(np.int64)
        return np.asarray(depth * cosine[at_rows[:, None], at_cols], np.float32)

    def _file(self, camera_name: str, stamp_ns: int) -> Path | None:
        for stem in (f"{camera_name}/{stamp_ns}", f"{camera_name}_{stamp_ns}"):
            for suffix in SUFFIXES:
                file = self.path / (stem + suffix)
                if file.is_file():
                    return file
        return None

    def _load(self, file: Path) -> Float32Array:
        values = _values(file)
        if values.ndim > 2 and values.size == values.shape[0] * values.shape[1]:
            values = values[..., 0]
        elif values.ndim > 2 and values.size == values.shape[-2] * values.shape[-1]:
            values = values.reshape(values.shape[-2:])  # networks give (1, H, W) or (1, 1, H, W)
        if values.ndim != 2 or values.size == 0 or values.dtype.kind not in "fiu":
            raise ImageError(f"{file}: a depth map has one number a pixel, this is {values.shape} {values.dtype}")
        if values.dtype.kind in "iu" and self.config.metres_per_unit is None:
            raise ImageError(
                f"{file}: integers say no unit: write metres_per_unit (0.001 for millimetres) to {self.path / CONFIG}"
            )
        depth: Float32Array = values.astype(np.float32) * np.float32(self.config.metres_per_unit or 1)
        return np.where(values == 0, np.float32(np.nan), depth) if values.dtype.kind in "iu" else depth


def _values(file: Path) -> NDArray[Any]:
    """The numbers of a file as they lie in it. Raises ImageError."""
    if file.suffix == ".npy":
        with file.open("rb") as stream:
            content = stream.read(_LARGEST + 1)
        if len(content) > _LARGEST:
            raise ImageError(f"{file}: no depth map (more than {_LARGEST >> 20} MiB)")
        return load_array(content, str(file), ImageError)
    if file.suffix == ".png":
        check_picture(file)
    else:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a depth map lies nowhere on the earth
            with open_raster(file) as source:
                check_size(source, file, source.height, source.width)
    try:
        values: Any = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise ImageError(f"{file}: no depth map ({error})") from error
    return np.empty(0) if values is None else np.asarray(values)
