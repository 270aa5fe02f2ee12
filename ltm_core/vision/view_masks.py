"""The masks of a turning camera's views: which one belongs to a picture, by where the camera looked.

What stands still before the lens of a turning camera, its own mast or a roof, lies elsewhere in each view. A mask drawn
in one view holds where the camera looks there again, with the lens as wide; anywhere else it would hide what is seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from ltm_core.camera import Camera
from ltm_core.pose import Pose
from ltm_core.types import UInt8Array
from ltm_core.vision.camera_mask import CameraMask
from ltm_core.vision.mask_config import ViewMask

MakeMask = Callable[[int, int], CameraMask]
"""The mask for pictures of a size (width, height). Raises ConfigError where it cannot be."""

_ZOOM = 0.03
"""By which the lens may be wider or narrower than the view's: at the edge of the picture, 1.5 % of its width."""


@dataclass(frozen=True)
class Looking:
    """Where a picture was taken to: azimuth and pitch of the optical axis, and how wide the lens was, degrees."""

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
        """Angle between the optical axes; infinite where the lens is not as wide as the view's."""
        if view.hfov_deg is not None and abs(self.hfov_deg / view.hfov_deg - 1) > _ZOOM:
            return math.inf
        turned = math.radians(self.azimuth_deg - view.azimuth_deg)
        own, other = math.radians(self.pitch_deg), math.radians(view.pitch_deg)
        # The haversine, which unlike the cosine holds for small angles.
        half = math.sin((own - other) / 2) ** 2 + math.cos(own) * math.cos(other) * math.sin(turned / 2) ** 2
        return math.degrees(2 * math.asin(math.sqrt(min(half, 1.0))))


class ViewMasks:
    """`views`: as the site file has them, each with what makes its mask. Raises what these do where they are of a known
    `size` (width, height)."""

    def __init__(self, views: Mapping[ViewMask, MakeMask], size: tuple[int, int] | None = None) -> None:
        self._views = dict(views)
        if size is not None:
            for make in self._views.values():
                make(*size)

    def at(self, looking: Looking) -> ViewMask | None:
        """The nearest of those views that look there; None: none does."""
        off = {view: looking.off_deg(view) for view in self._views}
        near = [view for view, angle in off.items() if angle <= view.within_deg]
        return min(near, key=off.__getitem__, default=None)

    def mask(self, view: ViewMask, width: int, height: int) -> CameraMask:
        """Raises ConfigError where it cannot be of this size."""
        return self._views[view](width, height)


def packed(mask: CameraMask) -> MakeMask:
    """What makes a mask that was read: for its own size alone. Kept as bits, for a patrol has many views."""
    size, place = mask.size, mask.place
    bits: UInt8Array = np.packbits(mask.hidden)

    def make(width: int, height: int) -> CameraMask:
        # A size that does not fit is told by the mask itself.
        whole = CameraMask(np.unpackbits(bits, count=size[0] * size[1]).reshape(size[::-1]).astype(np.bool_), place)
        whole.check_size(width, height)
        return whole

    return make
