import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import partial

import pytest
from scenes.raw_camera import RawCamera, raw_camera

from ltm_core.site.source_config import MjpegConfig, SnapshotConfig
from ltm_ros.cameras.protocols.credentials import SourceError
from ltm_ros.cameras.protocols.http_pictures import MjpegReader, SnapshotReader
from ltm_ros.cameras.protocols.picture import CameraReader

LETTERS = 150
"""That drip, one each tenth of a second: far longer than the limit, and not for ever where there is none."""


def _drip(answer: bytes, head: str) -> Iterator[bytes]:
    yield answer
    for _ in range(LETTERS):
        yield b"a"
        time.sleep(0.1)


def dripping(*answers: bytes) -> AbstractContextManager[RawCamera]:
    """A camera that sends the next of `answers` at once, and then drips; the last one to all further requests."""
    return raw_camera(*(partial(_drip, answer) for answer in answers))


def snapshot(url: str) -> CameraReader:
    return SnapshotReader(SnapshotConfig(kind="snapshot", url=url, timeout=0.3), 1 << 20)


def stream(url: str) -> CameraReader:
    return MjpegReader(MjpegConfig(kind="mjpeg", url=url, timeout=0.3), 1 << 20)


@pytest.mark.parametrize("kind", [snapshot, stream])
@pytest.mark.parametrize("begins", [b"", b"HTTP/1.1 ", b"HTTP/1.1 200 OK\r\nX: "])
def test_a_head_without_end(kind: Callable[[str], CameraReader], begins: bytes) -> None:
    with dripping(begins) as camera, pytest.raises(SourceError, match=r"took more than 0\.9 s"):
        kind(camera.url()).read()


def test_a_piece_of_a_stream_without_end() -> None:
    """In which the length of the next piece is said, and something besides: nothing of it comes out of httpx."""
    head = (
        b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=b\r\nTransfer-Encoding: chunked\r\n\r\n"
    )
    with dripping(head + b"5;x=") as camera, pytest.raises(SourceError, match=r"took more than 0\.9 s"):
        stream(camera.url()).read()


def test_the_next_picture_is_asked_for_as_if_nothing_had_been() -> None:
    picture = b"\xff\xd8\xff" + bytes(40) + b"\xff\xd9"
    whole = b"HTTP/1.1 200 OK\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\nConnection: close\r\n\r\n" % len(
        picture
    )
    with dripping(b"HTTP/1.1 200 OK\r\nX: ", whole + picture) as camera:
        reader = snapshot(camera.url())
        with pytest.raises(SourceError, match="took more than"):
            reader.read()
        for _ in range(2):
            read = reader.read()
            assert getattr(read, "jpeg", None) == picture
