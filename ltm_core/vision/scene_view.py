"""Decide which part of a camera's image shows the landscape, for labels, depth, poses and votes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.geometry.geodesy import sun_elevation
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_core.vision.mask_config import MaskConfig
from ltm_core.vision.masks import CameraMask, Looking, MakeMask, ViewMasks, packed, read_mask
from ltm_core.vision.network_image import once
from ltm_core.vision.overlays import fill_hidden, find_overlay
from ltm_core.vision.usable import Unusable, Usability, judge


@dataclass(frozen=True, eq=False)
class SceneView:
    """Visible landscape in an image. `hidden`: (H, W) bool, True where a mask, bar or frame hides it; None: nowhere.
    `usability`: whether the image shows enough; None: not judged. `masked`: the view mask used, if the camera has
    several. `smoke`: share of the image in which smoke hides the land."""

    hidden: BoolArray | None = None
    usability: Usability | None = None
    masked: str = ""
    smoke: float = 0.0

    @property
    def reason(self) -> Unusable | None:
        """Return why the image is not used; None: it is used."""
        return None if self.usability is None else self.usability.reason

    @property
    def unusable(self) -> str:
        """Return `reason` in words; empty if the image is used."""
        return "" if self.usability is None else self.usability.said

    @property
    def doubtful(self) -> BoolArray | None:
        """Return a grid (rows, columns) over the image, True where it is overexposed or black; None: nowhere."""
        if self.usability is None or not self.usability.doubtful.any():
            return None
        return self.usability.doubtful

    def scene(self, picture: UInt8Array) -> UInt8Array:
        """Return the image (H, W, 3) RGB for networks: what hides the landscape is filled from its surroundings."""
        return picture if self.hidden is None else fill_hidden(picture, self.hidden)

    def unlabelled(self, labels: UInt8Array, confidence: UInt8Array) -> None:
        """Remove labels (H, W) and their confidence (H, W), in place, where the landscape is not visible, in unusable
        images, and on overexposed or black land."""
        if self.reason is None and self.hidden is None and self.doubtful is None:
            return
        gone = np.full(labels.shape, self.reason is not None)
        if self.hidden is not None:
            gone |= self.hidden
        if self.doubtful is not None:
            size = labels.shape[::-1]
            cells = cv2.resize(self.doubtful.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
            gone |= cells & (labels != np.uint8(Label.SKY))
        labels[gone] = UNLABELLED
        confidence[gone] = 0


class SceneFilter:
    """Determine the visible landscape in each image of a camera.

    `make`: the camera's mask, that of all its views; None: it has none. `size`: of its images, where it is known
    beforehand. `judged`: whether images are judged usable. `views`: masks of single views besides. `place`: longitude
    and latitude of the site, radians, for the sun's elevation; None: it is not used."""

    def __init__(
        self,
        make: MakeMask | None = None,
        size: tuple[int, int] | None = None,
        judged: bool = True,
        views: ViewMasks | None = None,
        place: tuple[float, float] | None = None,
    ) -> None:
        self._make, self._judged, self._views, self._place = make, judged, views, place
        self.mask = make(*size) if make is not None and size is not None else None
        """Mask of all views as last used; None: there is none, or the image size is not known yet."""
        self._seen: tuple[str, BoolArray] | None = None

    @classmethod
    def of_png(cls, path: Path, place: str) -> SceneFilter:
        """Return the filter of a PNG mask; `place`: its name in errors. Raises ConfigError as `read_mask`, and if its
        size is not that of the images."""
        return cls(*mask_maker(path, place))

    def hidden(self, width: int, height: int, looking: Looking | None = None) -> BoolArray | None:
        """Return (H, W) bool, the masked pixels of images of this size in this direction (None: in all directions);
        None: no mask. Raises ConfigError."""
        view = None if self._views is None or looking is None else self._views.at(looking)
        if self._make is not None and (self.mask is None or self.mask.size != (width, height)):
            self.mask = self._make(width, height)
        common = None if self.mask is None else self.mask.hidden
        if view is None or self._views is None:
            return common
        # A camera dwells at a view: its mask is made once for all images of the stay.
        seen = self._seen
        if seen is None or seen[0] != view.name or seen[1].shape != (height, width):
            own = self._views.mask(view, width, height).hidden
            seen = self._seen = view.name, own if common is None else own | common
        return seen[1]

    def look(self, picture: UInt8Array, looking: Looking | None = None, stamp_ns: int | None = None) -> SceneView:
        """Return the scene view of an image (H, W, 3) RGB; `stamp_ns`: its time, None: unknown. Raises ConfigError if
        the mask has another size, ImageError for another shape."""
        _check(picture)
        hidden = self.hidden(picture.shape[1], picture.shape[0], looking)
        return replace(self._view(picture, hidden, stamp_ns), masked=self._masked(looking))

    def _view(self, picture: UInt8Array, masked: BoolArray | None, stamp_ns: int | None) -> SceneView:
        overlay = once(picture, find_overlay, lambda: find_overlay(picture))
        hidden = masked if overlay is None else overlay if masked is None else masked | overlay
        if not self._judged:
            return SceneView(hidden)
        sun_deg = None
        if self._place is not None and stamp_ns is not None:
            longitude, latitude = self._place
            sun_deg = float(np.degrees(sun_elevation(latitude, longitude, stamp_ns)))
        if hidden is None:
            return SceneView(None, once(picture, (judge, sun_deg), lambda: judge(picture, None, sun_deg)))
        return SceneView(hidden, judge(picture, hidden, sun_deg))

    def _masked(self, looking: Looking | None) -> str:
        if self._views is None or looking is None:
            return ""
        view = self._views.at(looking)
        return f"view {view.name}" if view is not None else f"no view of the site file has this direction: {looking}"


def _check(picture: UInt8Array) -> None:
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.size == 0:
        raise ImageError(f"the image has shape {picture.shape}, expected (H, W, 3) RGB")


def mask_maker(config: MaskConfig, place: str) -> tuple[MakeMask, tuple[int, int] | None]:
    """Return the function that makes the mask, and its size if it has one of its own. Raises ConfigError."""
    if not isinstance(config, Path):
        return partial(CameraMask.of_polygons, config, place=place), None
    read = read_mask(config, place)
    return packed(read), read.size
