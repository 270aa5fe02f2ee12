"""Watches a camera's lens: gives `DirtyLens` a picture of each view now and then, decoded no larger than it needs."""

from __future__ import annotations

import cv2
import numpy as np

from ltm_core.base.types import UInt8Array
from ltm_core.vision.dirty_lens import VIEWS, DirtyLens
from ltm_core.vision.usable import WORKING_WIDTH
from ltm_ros.cameras.protocols.direction import PtzReading, difference_deg
from ltm_ros.cameras.protocols.picture import CameraImage

SAME_VIEW_DEG, SAME_VIEW_ZOOM = 0.1, 0.02
"""By which pan and tilt, and by which share the zoom, differ at most where a PTZ head is at the same preset again."""
_REDUCED = ((4, cv2.IMREAD_REDUCED_COLOR_4), (2, cv2.IMREAD_REDUCED_COLOR_2), (1, cv2.IMREAD_COLOR))
"""JPEGs decode to a half and a quarter for little."""


class LensWatch:
    """Of one camera, by day."""

    def __init__(self) -> None:
        self._lens = DirtyLens()
        self._views: dict[int, PtzReading] = {}
        self._count = 0

    def look(self, picture: CameraImage, width: int, reading: PtzReading | None, now: float) -> None:
        """Take a picture `width` pixels wide that could be decoded, of a PTZ head at rest at `reading` where it has
        one."""
        view = self._view(reading)
        if self._lens.wants(view, now):
            self._lens.look(_rgb(picture, width), view, now)

    def said(self) -> str:
        """What is wrong with the lens; empty: nothing."""
        return self._lens.said()

    def _view(self, reading: PtzReading | None) -> int:
        if reading is None:
            return 0
        for number, known in self._views.items():
            if _same_view(known, reading):
                self._views[number] = self._views.pop(number)  # the last of them now
                return number
        self._count += 1
        self._views[self._count] = reading
        if len(self._views) > VIEWS:
            del self._views[next(iter(self._views))]
        return self._count


def _same_view(a: PtzReading, b: PtzReading) -> bool:
    turn = max(difference_deg(a.pan_deg, b.pan_deg), difference_deg(a.tilt_deg, b.tilt_deg))
    return turn <= SAME_VIEW_DEG and abs(a.zoom - b.zoom) <= SAME_VIEW_ZOOM * max(abs(a.zoom), abs(b.zoom))


def _rgb(picture: CameraImage, width: int) -> UInt8Array:
    if picture.rgb is not None:
        return picture.rgb
    flag = next(flag for factor, flag in _REDUCED if width // factor >= WORKING_WIDTH or factor == 1)
    data = np.frombuffer(picture.jpeg or b"", np.uint8)
    bgr = cv2.imdecode(data, flag | cv2.IMREAD_IGNORE_ORIENTATION)
    assert bgr is not None  # nosec B101 # its thumbnail was decoded
    return np.ascontiguousarray(np.asarray(bgr, np.uint8)[..., ::-1])
