"""Stream what the status page shows over one connection of at most 1 Mbit/s: small images, and the map when it changes.

A stream is a line `FIRST_LINE`, then records: a line of JSON with `kind` and `bytes`, then that many bytes.

| kind | further keys | content |
|---|---|---|
| page | | `page.json`, compressed by zlib |
| frame | camera, stamp_s, sizes | JPEGs of photo, labels and depth, one after the other; `sizes`: bytes of each |
| map | | PNG |"""

import json
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Final

from ltm_core.base.errors import LtmError

if TYPE_CHECKING:
    from ltm_ros.tower.last_pictures import CameraPicture, LastPictures

FIRST_LINE: Final = b"ltm live 2\n"
BYTES_PER_S: Final = 90_000
"""Bytes of all streams in a second. With the headers of TCP, TLS and SSH they stay below 1 Mbit/s."""
CHUNK: Final = 4096
"""Bytes after which the rate is checked."""
PAGE_S: Final = 2.0
"""Seconds between two pages; they also show that the connection works."""
MAP_S: Final = 5.0
"""Minimum time between two maps in seconds."""
MAP_SHARE: Final = 0.2
"""Maximum share of the rate that maps may take."""
IDLE_S: Final = 0.1
ROUND_S: Final = 2.0
"""Seconds in which every camera is sent once; images get smaller with the number of cameras."""
WIDTHS: Final = (640, 480, 320, 240, 160)
"""Widths of images in pixels. The next smaller one is taken while a frame has too many bytes for its camera's share of
the time, and the next larger one after a frame of less than a third of them."""
KINDS: Final = ("photo", "labels", "depth")
"""Images of a frame."""


class LiveStream:
    """`page`: returns the content of `page.json`. `tell`: gets the errors of images that are not sent. `rate`: bytes of
    all connections together in a second."""

    def __init__(
        self,
        page: Callable[[], dict[str, Any]],
        pictures: "LastPictures",
        tell: Callable[[LtmError], None],
        rate: float = BYTES_PER_S,
    ) -> None:
        self._page, self._pictures, self._tell, self._rate = page, pictures, tell, rate
        self._lock = threading.Lock()
        self._free_at = 0.0

    def stream(self) -> Iterator[bytes]:
        """Yield one client's bytes, no faster than the rate, until the client leaves."""
        for record in self._records():
            for start in range(0, len(record), CHUNK):
                chunk = record[start : start + CHUNK]
                with self._lock:
                    due = max(time.monotonic(), self._free_at)
                    self._free_at = due + len(chunk) / self._rate
                time.sleep(max(0.0, due - time.monotonic()))
                yield chunk

    def _records(self) -> Iterator[bytes]:
        yield FIRST_LINE
        sent: dict[str, float] = {}
        page_at = map_due = -float("inf")
        sent_map, size = b"", 1
        while True:
            news = {camera: s for camera, s in self._pictures.stamps_s().items() if sent.get(camera) != s}
            # The camera that was sent longest ago comes first; a new one before all.
            camera = min(news, key=lambda name: list(sent).index(name) if name in sent else -1, default=None)
            if time.monotonic() - page_at >= PAGE_S:
                page_at = time.monotonic()
                yield _record("page", zlib.compress(json.dumps(self._page(), default=str).encode()))
            if camera is not None and (picture := self._pictures.shown(camera)) is not None:
                sent.pop(camera, None)
                sent[camera] = picture.stamp_ns / 1e9
                try:
                    size, record = self._frame(picture, len(self._pictures.stamps_s()), size)
                except LtmError as error:
                    self._tell(error)
                else:
                    yield record
            if time.monotonic() >= map_due:
                if (png := self._map()) and png != sent_map:
                    sent_map = png
                    yield _record("map", png)
                map_due = time.monotonic() + max(MAP_S, len(sent_map) / (MAP_SHARE * self._rate))
            elif camera is None:
                time.sleep(IDLE_S)

    def _frame(self, picture: "CameraPicture", cameras: int, size: int) -> tuple[int, bytes]:
        """Return the images of a frame, and the index of the width for the next one. Raises ImageError."""
        room = self._rate * ROUND_S / max(1, cameras)
        images = self._pictures.jpegs(picture, WIDTHS[size])
        while (needed := sum(map(len, images))) > room and size < len(WIDTHS) - 1:
            size += 1
            images = self._pictures.jpegs(picture, WIDTHS[size])
        sizes, stamp_s = [len(image) for image in images], picture.stamp_ns / 1e9
        record = _record("frame", b"".join(images), camera=picture.name, stamp_s=stamp_s, sizes=sizes)
        return max(0, size - 1) if needed < room / 3 else size, record

    def _map(self) -> bytes | None:
        try:
            return self._pictures.map_png()
        except LtmError as error:
            self._tell(error)
            return None


def _record(kind: str, content: bytes, **about: object) -> bytes:
    return json.dumps({"kind": kind, "bytes": len(content), **about}).encode() + b"\n" + content
