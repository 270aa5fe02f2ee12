"""Read JPEG images from a snapshot address or an MJPEG stream."""

import contextlib
import re
import time
from collections.abc import Iterator

import httpx

from ltm_core.base.redaction import redacted
from ltm_core.site.source_config import MjpegConfig, SnapshotConfig
from ltm_ros.cameras.protocols.credentials import PictureError, SourceError
from ltm_ros.cameras.protocols.exposure import exif_time
from ltm_ros.cameras.protocols.http_client import HttpClient, HttpResponse, http_time, is_whole_jpeg, page_in
from ltm_ros.cameras.protocols.picture import CameraImage, Nothing, Timing, stated_number

_SHOWN, _SHOWN_TEXT = 16, 60
"""Number of bytes of an invalid answer that an error shows, and of a text."""


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
        body = picture_in(answer)
        self._remember(answer)
        modified = http_time(answer.headers, "Last-Modified") if self._modified_tells else None
        return CameraImage(answer.timing(self._oldest, exif_time(body) or modified), jpeg=body)

    def close(self) -> None:
        self._client.close()

    def _remember(self, answer: HttpResponse) -> None:
        tag, modified = answer.headers.get("etag"), answer.headers.get("last-modified")
        # Some servers send their start time, or another constant, with changing images.
        if modified is not None and modified == self._modified and hash(answer.body) != self._body and self.pause > 1:
            self._modified_tells = False
        self._modified, self._body = modified, hash(answer.body)
        given = {"If-None-Match": tag, "If-Modified-Since": modified if self._modified_tells else None}
        self._conditions = {name: value for name, value in given.items() if value is not None}


def picture_in(answer: HttpResponse) -> bytes:
    """Return the image of an answer. Raises PictureError for a login page, an error text or an empty answer."""
    body = answer.body.lstrip(b"\r\n")  # some cameras send an empty line too many
    if body[:3] == _BEGIN or body[:8] == b"\x89PNG\r\n\x1a\n":
        if body.rfind(b"\xff\xd9") < body.rfind(b"\xff\xda"):
            raise PictureError(
                f"the image has no end-of-image marker in {len(body)} bytes: the camera cuts it, or states too short a "
                "Content-Length"
            )
        return body
    if page := page_in(body):
        raise PictureError(f"the camera answered with {page} instead of an image; check the url and the authentication")
    kind, text = answer.headers.get("content-type", ""), body[:_SHOWN_TEXT].decode("latin-1")
    begins = repr(redacted(text)) if text and text.isprintable() else body[:_SHOWN].hex(" ") or "nothing"
    encoded = ", base64 instead of the bytes" if text.startswith(("/9j/", "data:image")) else ""
    raise PictureError(
        f"the camera answered {kind[:60] or 'of unknown type'} of {len(body)} bytes that begin with {begins}: that is "
        f"neither JPEG nor PNG{encoded}; check the url"
    )


_BEGIN = b"\xff\xd8\xff"
_OLDEST_S = 0.3
"""Maximum age in seconds of an image that is sent right after its exposure."""
_HEAD_BYTES = 4 << 10
"""Maximum bytes of a part's header."""


class MjpegReader:
    def __init__(self, config: MjpegConfig, most_bytes: int) -> None:
        self.pause = 0.0
        self._every, self._most_bytes = config.every, most_bytes
        self._client = HttpClient(config, most_bytes=most_bytes)
        self._open = contextlib.ExitStack()
        try:
            response, _, _ = self._open.enter_context(self._client.stream(config.url))
            boundary = _declared_boundary(response)
        except BaseException:
            self.close()
            raise
        self._parts = self._split(response, boundary)
        self._due = 0.0

    def read(self) -> CameraImage | Nothing:
        """Return the next due image; earlier ones are read and dropped."""
        with self._client.in_time():
            part = next(self._parts, None)
        if part is None:
            raise SourceError("the camera ended its stream")
        head, body, arrived = part
        if arrived < self._due:
            return Nothing.YET
        if not body.startswith(_BEGIN):
            raise PictureError(f"a part of the stream with {len(body)} bytes is not a JPEG")
        self._due = arrived + self._every
        stream = stated_number(head.get("x-timestamp"))  # some cameras count seconds there
        return CameraImage(Timing(arrived, oldest=_OLDEST_S, stream=stream), jpeg=body)

    def close(self) -> None:
        with contextlib.suppress(SourceError):
            self._open.close()
        self._client.close()

    def _split(self, response: httpx.Response, boundary: bytes) -> Iterator[tuple[dict[str, str], bytes, float]]:
        """Yield each part's header, its body, and the arrival time of its last byte."""
        parts = PartSplitter(boundary, self._most_bytes)
        for chunk in response.iter_bytes():
            for head, body in parts.feed(chunk):
                yield head, body, time.monotonic()


class PartSplitter:
    """Splits a multipart answer into its parts, by the line that the stream begins with, because cameras write dashes
    and case otherwise than they declare; else by `declared`. A stated length is used if an image ends there. Source:
    RFC 2046, 5.1; cameras implement half of it."""

    def __init__(self, declared: bytes, most_bytes: int) -> None:
        self._declared, self._most_bytes = declared.lstrip(b"-"), most_bytes
        self._mark: re.Pattern[bytes] | None = None
        self._buffer = bytearray()
        self._sought = 0
        """Number of bytes in which no end of the image was found."""

    def feed(self, chunk: bytes) -> Iterator[tuple[dict[str, str], bytes]]:
        """Return header and body of each completed part. Raises SourceError if no part can be completed."""
        self._buffer += chunk
        while (found := self._take()) is not None:
            yield found
        if len(self._buffer) > self._most_bytes + _HEAD_BYTES:
            raise SourceError(f"an image of more than {self._most_bytes} bytes, or a stream without boundaries")

    def _take(self) -> tuple[dict[str, str], bytes] | None:
        buffer = self._buffer
        begin = self._line(0)
        if begin is None or len(buffer) < begin.end() + 2:
            return None
        head, start = dict[str, str](), begin.end()
        if buffer[start : start + 2] != _BEGIN[:2]:
            blank = _BLANK.search(buffer, start - 1)
            if blank is None:
                return None
            lines = (str(line, "latin-1").partition(":") for line in buffer[start : blank.start()].splitlines())
            head, start = {name.strip().lower(): value.strip() for name, _, value in lines}, blank.end()
        length = int(stated_number(head.get("content-length")) or 0)
        if length > self._most_bytes:
            raise SourceError(f"an image of {length} bytes is announced; the maximum is {self._most_bytes}")
        end = start + length
        if length <= 0 or len(buffer) < end or not is_whole_jpeg(buffer[start:end]):
            following = self._line(start)
            # Before the stated length has come, what looks like a boundary may be a part of the image.
            if following is None or (len(buffer) < end and not is_whole_jpeg(buffer[start : following.start()])):
                return None
            end = following.start()
        body = bytes(buffer[start:end]).strip(b"\r\n")
        del buffer[:end]
        self._sought = 0
        return head, body

    def _line(self, start: int) -> re.Match[bytes] | None:
        """Return the next line between two parts."""
        buffer = self._buffer
        if self._mark is None:
            first = _FIRST_LINE.match(buffer)
            if first is None and len(buffer) < _FIRST_BYTES:
                return None
            line = b"" if first is None else first[1].rstrip()
            given = line.startswith(b"--") or (self._declared and self._declared.lower() in line.lower())
            if not given and not self._declared:
                raise SourceError("the stream has no boundary between its images; check the url")
            mark = re.escape(line if given else b"--" + self._declared)
            self._mark = re.compile(rb"(?:\A|(?<=\n)|(?<=\xff\xd9))%b(?:--)?[ \t]{0,80}\r?\n" % mark)
        found = self._mark.search(buffer, max(start, self._sought) if start else 0)
        if found is None:
            self._sought = max(len(buffer) - _HEAD_BYTES, 0) if start else 0
        return found


_BLANK = re.compile(rb"\n\r?\n")
_FIRST_BYTES = 1024
_FIRST_LINE = re.compile(rb"[\r\n]{0,16}([^\r\n]{1,200})\r?\n")


def _declared_boundary(response: httpx.Response) -> bytes:
    """Return the stated boundary; empty: none. Raises SourceError if the answer is no stream."""
    kind: str = response.headers.get("content-type", "")
    if "multipart" not in kind.lower():
        page = "" if "image/" in kind else page_in(next(response.iter_bytes(), b""))
        remedy = "set kind: snapshot" if "image/" in kind else "check the url"
        raise SourceError(f"the camera answered {page or kind[:60] or 'no type'}, not a stream of JPEGs; {remedy}")
    found = re.search(r'(?i)boundary\s*=\s*(?:"([^"]*)"|([^;]*))', kind)
    return (found[1] or found[2] or "").strip().encode() if found else b""
