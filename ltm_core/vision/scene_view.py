"""Decide which part of a camera's image shows the landscape, for labels, depth, poses and votes."""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.geometry.geodesy import sun_elevation
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_core.vision.mask_config import ViewMask
from ltm_core.vision.masks import Looking, MakeMask, nearest_view
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
        """Remove labels and their confidence (H, W), in place, where the landscape is not visible or overexposed."""
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
    and latitude of the site, radians, for the sun's elevation; None: it is not used. Raises ConfigError."""

    def __init__(
        self,
        make: MakeMask | None = None,
        size: tuple[int, int] | None = None,
        judged: bool = True,
        views: Mapping[ViewMask, MakeMask] = {},
        place: tuple[float, float] | None = None,
    ) -> None:
        self._make, self._judged, self._views, self._place = make, judged, dict(views), place
        self.mask = make(*size) if make is not None and size is not None else None
        """(H, W) mask of all views as last used; None: there is none, or the image size is not known yet."""
        self._seen: tuple[str, BoolArray] | None = None
        for make_view in self._views.values():
            if size is not None:
                make_view(*size)

    def hidden(self, width: int, height: int, looking: Looking | None = None) -> BoolArray | None:
        """Return (H, W) bool, the masked pixels of images of this size in this direction (None: in all directions);
        None: no mask. Raises ConfigError."""
        view = None if looking is None else nearest_view(self._views, looking)
        if self._make is not None and (self.mask is None or self.mask.shape != (height, width)):
            self.mask = self._make(width, height)
        if view is None:
            return self.mask
        # A camera dwells at a view: its mask is made once for all images of the stay.
        if self._seen is None or self._seen[0] != view.name or self._seen[1].shape != (height, width):
            own = self._views[view](width, height)
            self._seen = view.name, own if self.mask is None else own | self.mask
        return self._seen[1]

    def look(self, picture: UInt8Array, looking: Looking | None = None, stamp_ns: int | None = None) -> SceneView:
        """Return the scene view of an image (H, W, 3) RGB; `stamp_ns`: its time, None: unknown. Raises ConfigError if
        the mask has another size, ImageError for another shape."""
        if picture.ndim != 3 or picture.shape[2] != 3 or picture.size == 0:
            raise ImageError(f"the image has shape {picture.shape}, expected (H, W, 3) RGB")
        hidden = self.hidden(picture.shape[1], picture.shape[0], looking)
        overlay = once(picture, find_overlay, lambda: find_overlay(picture))
        if overlay is not None:
            hidden = overlay if hidden is None else hidden | overlay
        usability, sun_deg = None, None
        if self._judged:
            if self._place is not None and stamp_ns is not None:
                longitude, latitude = self._place
                sun_deg = float(np.degrees(sun_elevation(latitude, longitude, stamp_ns)))
            # Without a mask of this camera, the judgement is the same for all nodes.
            whole = once(picture, (judge, sun_deg), lambda: judge(picture, None, sun_deg)) if hidden is None else None
            usability = whole or judge(picture, hidden, sun_deg)
        masked = ""
        if self._views and looking is not None:
            view = nearest_view(self._views, looking)
            masked = f"view {view.name}" if view else f"no view of the site file has this direction: {looking}"
        return SceneView(hidden, usability, masked)
