"""A camera that gives one JPEG a request."""

from __future__ import annotations

from ltm_core.source_config import SnapshotConfig
from ltm_ros.sources.errors import PictureError
from ltm_ros.sources.http_client import Answer, HttpClient, http_time
from ltm_ros.sources.jpeg_time import exif_time
from ltm_ros.sources.picture import CameraTime, Nothing, Picture, Timing

_SHOWN = 16
"""Bytes of an answer that is no picture that an error shows."""


class SnapshotReader:
    """Asks on the condition that the picture has changed (ETag, Last-Modified), as far as the camera knows of that."""

    def __init__(self, config: SnapshotConfig, most_bytes: int) -> None:
        self.pause = config.every
        self._url, self._oldest = config.url, config.oldest
        self._client = HttpClient(config, most_bytes=most_bytes)
        self._conditions: dict[str, str] = {}
        self._modified: str | None = None
        self._body = 0
        self._modified_tells = True

    def read(self) -> Picture | Nothing:
        answer = self._client.get(self._url, self._conditions)
        if answer.status == 304:
            return Nothing.UNCHANGED
        check_begins_as_picture(answer)
        self._remember(answer)
        return Picture(
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

    def _remember(self, answer: Answer) -> None:
        modified = answer.headers.get("last-modified")
        # Some servers state when they were started, or another constant, beside pictures that change.
        if modified is not None and modified == self._modified and hash(answer.body) != self._body and self.pause > 1:
            self._modified_tells = False
        self._modified, self._body = modified, hash(answer.body)
        self._conditions = {}
        if (tag := answer.headers.get("etag")) is not None:
            self._conditions["If-None-Match"] = tag
        if modified is not None and self._modified_tells:
            self._conditions["If-Modified-Since"] = modified

    def _taken(self, answer: Answer) -> CameraTime | None:
        stated = exif_time(answer.body)
        if stated is not None:
            return stated
        return http_time(answer.headers, "Last-Modified") if self._modified_tells else None


def check_begins_as_picture(answer: Answer) -> None:
    """Raises PictureError for a log-in page, an error in words, nothing at all."""
    if answer.body[:3] != b"\xff\xd8\xff" and answer.body[:8] != b"\x89PNG\r\n\x1a\n":
        kind = answer.headers.get("content-type", "of no stated type")
        begins = answer.body[:_SHOWN].hex(" ") or "nothing"
        raise PictureError(
            f"the camera answers {kind[:60]} of {len(answer.body)} bytes that begin with {begins}: that is neither "
            "JPEG nor PNG; check the url"
        )
