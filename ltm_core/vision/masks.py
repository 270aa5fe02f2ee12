"""Mask the pixels of a camera that never show the landscape, for each of its views.

What stands still before the lens of a turning camera, its own mast or a roof, lies elsewhere in each view. A mask drawn
in one view holds where the camera looks there again, with the lens as wide; anywhere else it would hide what is seen.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import cv2
import numpy as np
from PIL import Image

from ltm_core.base.errors import ConfigError, ImageError
from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.storage.image_io import read_values
from ltm_core.vision.mask_config import MaskConfig, ViewMask


def fill(drawn: UInt8Array, polygon: Sequence[Sequence[float]], value: int = 1) -> None:
    """Set the pixels (H, W) whose centres a polygon of (u, v) covers, its edge included."""
    points = np.rint(np.array(polygon, np.float64)).astype(np.int32)
    cv2.fillPoly(drawn, [points.reshape(-1, 1, 2)], [value])


class MaskMaker:
    """Mask of a key of the site file, `place`: call it with the size (width, height) of the images; it returns (H, W)
    bool, True where the landscape is never visible. A PNG, of its own `size` only, is kept as bits, because a patrol
    has many views. Raises ConfigError for another format, and for a mask that hides nothing, or everything; when
    called, for another size, and for a polygon outside the image."""

    def __init__(self, config: MaskConfig, place: str) -> None:
        self._polygons, self._place = config if isinstance(config, tuple) else (), place
        self.size: tuple[int, int] | None = None
        """Width and height; None: any."""
        if isinstance(config, tuple):
            return
        try:
            values = read_values(config)
        except ImageError as error:
            raise ConfigError(f"{place}: {error}") from error
        if values.ndim != 2:
            raise ConfigError(
                f"{place}: {config} has colours or transparency ({values.shape[2]} channels); a mask is a "
                "single-channel PNG, 0 where the landscape is seen"
            )
        self._place = f"{place}: {config}"
        self.size = values.shape[1], values.shape[0]
        self._bits: UInt8Array = np.packbits(self._checked(values != 0))

    def __call__(self, width: int, height: int) -> BoolArray:
        if self.size is None:
            return self._checked(self._drawn(width, height))
        if self.size != (width, height):
            raise ConfigError(
                f"{self._place}: the mask has {self.size[0]} x {self.size[1]} pixels, but the camera's images have "
                f"{width} x {height}; draw it again in that size (`ltm mask`)"
            )
        return np.unpackbits(self._bits, count=width * height).reshape(height, width).astype(np.bool_)

    def _drawn(self, width: int, height: int) -> BoolArray:
        drawn = np.zeros((height, width), np.uint8)
        for number, polygon in enumerate(self._polygons):
            points = np.array(polygon.polygon, np.float64)
            if (points.max(axis=0) < -0.5).any() or (points.min(axis=0) > (width - 0.5, height - 0.5)).any():
                spans = f"{points.min(axis=0).tolist()} to {points.max(axis=0).tolist()}"
                where = f"outside the image of {width} x {height} ({spans})"
                raise ConfigError(f"{self._place}.{number}: the polygon is {where}")
            fill(drawn, points.tolist())
        return drawn > 0

    def _checked(self, hidden: BoolArray) -> BoolArray:
        if not hidden.any():
            raise ConfigError(f"{self._place}: the mask hides nothing; draw an area, or remove the key")
        if hidden.all():
            fault = "the mask hides the whole image; it may be inverted (non-zero is masked)"
            raise ConfigError(f"{self._place}: {fault}")
        return hidden


def write_mask(path: Path, hidden: BoolArray) -> None:
    """Write (H, W) bool as a PNG that `MaskMaker` takes: 255 where masked."""
    Image.fromarray(np.where(hidden, 255, 0).astype(np.uint8)).save(path, "PNG", optimize=True)


MakeMask = Callable[[int, int], BoolArray]  # for images of a size (width, height), as `MaskMaker`
_ZOOM = 0.03
"""Relative difference of the field of view within which a view mask applies: 1.5 % of the width at the edge."""


@dataclass(frozen=True)
class Looking:
    """Viewing direction of an image: azimuth and pitch of the optical axis, and field of view, degrees."""

    azimuth_deg: float
    pitch_deg: float
    hfov_deg: float

    @classmethod
    def of(cls, camera: Camera, pose: Pose) -> Self:
        azimuth, pitch, _ = pose.angles_deg
        return cls(azimuth, pitch, camera.hfov_deg)

    def __str__(self) -> str:
        return f"azimuth {self.azimuth_deg:.1f}, pitch {self.pitch_deg:.1f}, {self.hfov_deg:.1f} deg wide"

    def off_deg(self, view: ViewMask) -> float:
        """Return the angle between the optical axes; infinite if the fields of view differ."""
        if view.hfov_deg is not None and abs(self.hfov_deg / view.hfov_deg - 1) > _ZOOM:
            return math.inf
        turned = math.radians(self.azimuth_deg - view.azimuth_deg)
        own, other = math.radians(self.pitch_deg), math.radians(view.pitch_deg)
        # The haversine, which unlike the cosine holds for small angles.
        half = math.sin((own - other) / 2) ** 2 + math.cos(own) * math.cos(other) * math.sin(turned / 2) ** 2
        return math.degrees(2 * math.asin(math.sqrt(min(half, 1.0))))


def nearest_view(views: Iterable[ViewMask], looking: Looking) -> ViewMask | None:
    """Return the nearest view in that direction; None: none."""
    off = {view: looking.off_deg(view) for view in views}
    near = [view for view, angle in off.items() if angle <= view.within_deg]
    return min(near, key=off.__getitem__, default=None)
