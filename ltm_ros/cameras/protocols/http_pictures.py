"""Read JPEG images from a snapshot address or an MJPEG stream."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping

import httpx

from ltm_core.site.source_config import MjpegConfig, SnapshotConfig
from ltm_ros.cameras.protocols.credentials import PictureError, SourceError
from ltm_ros.cameras.protocols.exposure import exif_time
from ltm_ros.cameras.protocols.http_client import WHOLE_FACTOR, HttpClient, HttpResponse, http_time
from ltm_ros.cameras.protocols.picture import CameraImage, CameraTime, Nothing, Timing, stated_number

_SHOWN = 16
"""Number of bytes of an invalid answer that an error shows."""


class SnapshotReader:
    """Requests the image if it has changed (ETag, Last-Modified), as far as the camera supports it."""

    def __init__(self, config: SnapshotConfig, most_bytes: int) -> None:
        self.pause = config.every
        self._url, self._oldest = config.url, config.oldest
        self._client = HttpClient(config, most_bytes=most_bytes)
        self._conditions: dict[str, str] = {}
        self._modified: str | None = None
        self._body = 0
        self._modified_tells = True

    def read(self) -> CameraImage | Nothing:
        answer = self._client.get(self._url, self._conditions)
        if answer.status == 304:
            return Nothing.UNCHANGED
        check_begins_as_picture(answer)
        self._remember(answer)
        return CameraImage(
            Timing(
                arrived=answer.arrived,
                asked=answer.asked,
                oldest=self._oldest,
                taken=self._taken(answer),
                answered=http_time(answer.headers, "Date"),
            ),
            jpeg=answer.body,
        )

    def close(self) -> None:
        self._client.close()

    def _remember(self, answer: HttpResponse) -> None:
        modified = answer.headers.get("last-modified")
        # Some servers send their start time, or another constant, with changing images.
        if modified is not None and modified == self._modified and hash(answer.body) != self._body and self.pause > 1:
            self._modified_tells = False
        self._modified, self._body = modified, hash(answer.body)
        self._conditions = {}
        if (tag := answer.headers.get("etag")) is not None:
            self._conditions["If-None-Match"] = tag
        if modified is not None and self._modified_tells:
            self._conditions["If-Modified-Since"] = modified

    def _taken(self, answer: HttpResponse) -> CameraTime | None:
        stated = exif_time(answer.body)
        if stated is not None:
            return stated
        return http_time(answer.headers, "Last-Modified") if self._modified_tells else None


def check_begins_as_picture(answer: HttpResponse) -> None:
    """Check that it is an image. Raises PictureError for a log-in page, an error text or an empty answer."""
    if answer.body[:3] != b"\xff\xd8\xff" and answer.body[:8] != b"\x89PNG\r\n\x1a\n":
        kind = answer.headers.get("content-type", "of unknown type")
        begins = answer.body[:_SHOWN].hex(" ") or "nothing"
        raise PictureError(
            f"the camera answered {kind[:60]} of {len(answer.body)} bytes that begin with {begins}: that is "
            "neither JPEG nor PNG; check the url"
        )


_OLDEST_S = 0.3
"""Maximum age in seconds of an image that is sent right after its exposure."""
_HEAD_BYTES = 4 << 10
"""Maximum bytes of a part's header."""
_BEGIN = b"\xff\xd8\xff"


class MjpegReader:
    def __init__(self, config: MjpegConfig, most_bytes: int) -> None:
        self.pause = 0.0
        self._every, self._most_bytes, self._silent_s = config.every, most_bytes, config.timeout
        self._whole_s = WHOLE_FACTOR * config.timeout
        self._client = HttpClient(config, most_bytes=most_bytes)
        self._open = contextlib.ExitStack()
        try:
            response, _, _ = self._open.enter_context(self._client.stream(config.url))
            boundary = _boundary(response)
        except BaseException:
            self.close()
            raise
        self._parts = self._split(response, boundary)
        self._due = 0.0

    def read(self) -> CameraImage | Nothing:
        """Return the next due image; earlier ones are read and dropped."""
        head, body, arrived = self._next()
        if arrived < self._due:
            return Nothing.YET
        if not body.startswith(_BEGIN):
            raise PictureError(f"a part of the stream with {len(body)} bytes is not a JPEG")
        self._due = arrived + self._every
        return CameraImage(timing_of(head, arrived), jpeg=body)

    def close(self) -> None:
        with contextlib.suppress(SourceError):
            self._open.close()
        self._client.close()

    def _next(self) -> tuple[dict[str, str], bytes, float]:
        try:
            with self._client.within(self._whole_s):
                return next(self._parts)
        except StopIteration:
            raise SourceError("the camera ended its stream") from None
        except httpx.TimeoutException:
            raise SourceError(f"the camera does not respond: no image for {self._silent_s:g} s") from None
        except (httpx.HTTPError, httpx.StreamError, OSError) as error:
            raise SourceError(f"the camera closed the connection ({type(error).__name__})") from None

    def _split(self, response: httpx.Response, boundary: bytes) -> Iterator[tuple[dict[str, str], bytes, float]]:
        """Yield each part's header, its body, and the arrival time of its last byte."""
        parts, until = PartSplitter(boundary, self._most_bytes), time.monotonic() + self._whole_s
        for chunk in response.iter_bytes():
            for head, body in parts.feed(chunk):
                until = time.monotonic() + self._whole_s
                yield head, body, time.monotonic()
            if time.monotonic() > until:
                raise SourceError(f"no complete image for {self._whole_s:g} s")


class PartSplitter:
    """Splits a multipart answer into its parts, by the stated length or by the boundary. Source: RFC 2046, 5.1; cameras
    implement half of it.
    """

    def __init__(self, boundary: bytes, most_bytes: int) -> None:
        self._boundary, self._most_bytes = boundary, most_bytes
        self._buffer = bytearray()

    def feed(self, chunk: bytes) -> Iterator[tuple[dict[str, str], bytes]]:
        """Return header and body of each completed part. Raises SourceError if no part can be completed."""
        self._buffer += chunk
        while (found := self._take()) is not None:
            yield found
        if len(self._buffer) > self._most_bytes + _HEAD_BYTES:
            raise SourceError(f"an image of more than {self._most_bytes} bytes, or a stream without boundaries")

    def _take(self) -> tuple[dict[str, str], bytes] | None:
        buffer = self._buffer
        begin = buffer.find(self._boundary)
        head_end = -1 if begin < 0 else buffer.find(b"\r\n\r\n", begin)
        if head_end < 0:
            return None
        head = _head(bytes(buffer[begin:head_end]))
        start = head_end + 4
        length = stated_number(head.get("content-length"))
        if length is None:
            end = buffer.find(self._boundary, start)
        elif 0 < length <= self._most_bytes:
            end = start + int(length)
        else:
            raise SourceError(f"an image of {length:g} bytes is announced; the maximum is {self._most_bytes}")
        if end < 0 or len(buffer) < end:
            return None
        body = bytes(buffer[start:end])
        del buffer[:end]
        return head, body.rstrip(b"\r\n") if length is None else body


def timing_of(head: Mapping[str, str], arrived: float) -> Timing:
    """Return the timing of a part from its header; some cameras count seconds there."""
    return Timing(arrived=arrived, oldest=_OLDEST_S, stream=stated_number(head.get("x-timestamp")))


def _boundary(response: httpx.Response) -> bytes:
    kind: str = response.headers.get("content-type", "")
    _, found, boundary = kind.partition("boundary=")
    if "multipart" not in kind.lower() or not found:
        raise SourceError(f"the camera answered {kind[:60] or 'no type'}, not a stream of JPEGs; check the url")
    return b"--" + boundary.split(";")[0].strip().strip('"').removeprefix("--").encode()


def _head(data: bytes) -> dict[str, str]:
    lines = (line.partition(b":") for line in data.split(b"\r\n")[1:])
    return {name.decode("latin-1").strip().lower(): value.decode("latin-1").strip() for name, _, value in lines}
