"""Finds the pictures of an archive's frames again, and looks at them small to tell clear ones from others."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from ltm_core.errors import ArchiveError, ImageError, LtmError, RecordingError
from ltm_core.site import Site
from ltm_core.types import UInt8Array
from ltm_core.vision.scene_view import SceneFilter
from ltm_core.vision.usable import WORKING_WIDTH, judge
from ltm_msgs_py.bag.picture_cdr import CompressedPicture, RawPicture, picture_of
from ltm_msgs_py.bag.reader import BagReader
from ltm_ros.archive.content_digest import picture_digest
from ltm_ros.archive.manifest import ArchiveFrame

_REDUCED = {8: cv2.IMREAD_REDUCED_COLOR_8, 4: cv2.IMREAD_REDUCED_COLOR_4, 2: cv2.IMREAD_REDUCED_COLOR_2}
"""A JPEG is decoded to an eighth of its size in a fraction of the time."""


class PictureReader:
    """Reads pictures by file, topic and log time: of a recording of many cameras, only the chunks that hold them."""

    def __init__(self) -> None:
        self._readers: dict[str, BagReader] = {}

    def read(self, frame: ArchiveFrame) -> CompressedPicture | RawPicture:
        """Raises ArchiveError where the file is gone or has the picture no longer, OSError where it cannot be read."""
        if frame.file not in self._readers:
            try:
                self._readers[frame.file] = BagReader(Path(frame.file))
            except RecordingError as error:
                raise ArchiveError(f"{error}; it was there when the archive was looked through") from error
        at = frame.log_time_ns
        for message in self._readers[frame.file].messages([frame.topic], at, at + 1):
            if picture_digest(message.raw) == frame.content:
                return picture_of(message.raw, message.type_name)
        raise ArchiveError(
            f"{frame.file} no longer holds the picture of {frame.topic} that was found there at log time {at} ns: it "
            "has changed since; run again"
        )


class SmallLook:
    """Says of a camera's pictures why they show too little, as the labelling does of whole ones (`usable.judge`)."""

    def __init__(self, site: Site, camera: str) -> None:
        self._scene, self._judged = SceneFilter.of(site, camera), site.camera(camera).judge_pictures
        self._reader = PictureReader()

    def __call__(self, frame: ArchiveFrame) -> str:
        """Empty: it is clear. Raises ArchiveError as `PictureReader.read`."""
        picture = self._reader.read(frame)
        try:
            small = _small(picture)
        except LtmError as error:
            return f"damaged: {error}"
        if not self._judged:
            return ""
        hidden = self._scene.hidden(*picture.size)
        if hidden is not None:
            size = small.shape[1], small.shape[0]
            hidden = cv2.resize(hidden.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        return judge(small, hidden).said


def _small(picture: CompressedPicture | RawPicture) -> UInt8Array:
    """(h, w, 3) RGB, no narrower than it is judged at, where it is larger. Raises ImageError."""
    width, _ = picture.size
    scale = next((scale for scale in _REDUCED if width >= scale * WORKING_WIDTH), 1)
    if isinstance(picture, RawPicture) or scale == 1:
        return picture.rgb()
    found = cv2.imdecode(np.frombuffer(picture.data, np.uint8), _REDUCED[scale] | cv2.IMREAD_IGNORE_ORIENTATION)
    if found is None:
        raise ImageError(f"picture of {len(picture.data)} bytes is corrupt: OpenCV cannot decode it")
    return np.asarray(cv2.cvtColor(found, cv2.COLOR_BGR2RGB), np.uint8)
