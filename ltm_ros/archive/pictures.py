"""Find the images of an archive's frames again, and check by thumbnails whether they are clear."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from ltm_core.base.errors import ArchiveError, LtmError, RecordingError
from ltm_core.base.types import UInt8Array
from ltm_core.site.networks import site_scene_filter
from ltm_core.site.site import Site
from ltm_core.vision.masks import Looking
from ltm_core.vision.usable import WORKING_WIDTH
from ltm_msgs_py.bag.cdr import CompressedPicture, RawPicture, picture_of
from ltm_msgs_py.bag.reader import BagReader
from ltm_ros.archive.content_digest import picture_digest
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.scan import PHOTOS, photo_picture

_REDUCED = (8, 4, 2)
"""A JPEG is decoded to an eighth of its size in a fraction of the time."""
_HELD = 4
"""Maximum number of open recordings: recordings of one time overlap little."""


class ArchiveImageReader:
    """Reads pictures by file, topic and log time: of a recording of many cameras, only the chunks that hold them."""

    def __init__(self) -> None:
        self._open: dict[str, BagReader] = {}

    def read(self, frame: ArchiveFrame) -> CompressedPicture | RawPicture:
        """Read an image. Raises ArchiveError if the file is missing, no longer has the image or cannot be read now,
        OSError if the local disk fails."""
        found = self._photo(frame) if frame.file.lower().endswith(PHOTOS) else self._recorded(frame)
        if found is None:
            raise ArchiveError(
                f"{frame.file} no longer contains the image of {frame.topic} at log time {frame.log_time_ns} ns: "
                "the file has changed; run again"
            )
        return found

    def _photo(self, frame: ArchiveFrame) -> CompressedPicture | None:
        path = Path(frame.file)
        if path.stat().st_size != frame.size_bytes:  # before it is read: what is there now may be of any size
            return None
        picture = photo_picture(path.read_bytes(), frame.stamp_ns)
        return picture if picture_digest(picture) == frame.content else None

    def _recorded(self, frame: ArchiveFrame) -> CompressedPicture | RawPicture | None:
        reader = self._reader(frame.file)
        at = frame.log_time_ns
        for message in reader.messages([frame.topic], at, at + 1):
            try:
                picture = picture_of(message.raw, message.type_name)
            except LtmError:  # of the same time, and not ours, which was one when it was found
                continue
            if (picture.stamp_ns, picture_digest(picture)) == (frame.stamp_ns, frame.content):
                return picture
        if reader.unread:
            raise ArchiveError(f"{frame.file} cannot be read now: {'; '.join(reader.unread)}")
        return None

    def _reader(self, name: str) -> BagReader:
        if name not in self._open:
            if len(self._open) == _HELD:
                del self._open[next(iter(self._open))]
            try:
                self._open[name] = BagReader(Path(name))
            except RecordingError as error:
                raise ArchiveError(f"{error}; it existed when the archive was scanned") from error
        return self._open[name]


class SmallLook:
    """Says of a camera's pictures why they show too little, as the labelling does of whole ones (`usable.judge`)."""

    def __init__(self, site: Site, camera: str, reader: ArchiveImageReader) -> None:
        self._scene, self._reader = site_scene_filter(site, camera), reader

    def __call__(self, frame: ArchiveFrame) -> str:
        """Empty: it is clear. Raises ArchiveError as `ArchiveImageReader.read`."""
        picture = self._reader.read(frame)
        try:
            small = _small(picture)
        except LtmError as error:
            return f"damaged: {error}"
        hidden = self._scene.hidden(*picture.size, Looking.of(frame.calibration, frame.pose))
        if hidden is not None:
            size = small.shape[1], small.shape[0]
            hidden = cv2.resize(hidden.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        return self._scene.look_masked(small, hidden, frame.stamp_ns).unusable


def _small(picture: CompressedPicture | RawPicture) -> UInt8Array:
    """(h, w, 3) RGB, no narrower than it is judged at, where it is larger. Raises ImageError."""
    width, _ = picture.size
    scale = next((scale for scale in _REDUCED if width >= scale * WORKING_WIDTH), 1)
    return picture.rgb() if isinstance(picture, RawPicture) else picture.rgb(scale)
