"""A camera of a network that lists its cameras in one JSON, with times and directions, beside a picture of each."""

from __future__ import annotations

import json
import time
from datetime import UTC, datetime
from typing import Any

from ltm_core.site.source_config import CameraListConfig
from ltm_ros.cameras.protocols.direction import PtzReading, Tolerance, at_rest
from ltm_ros.cameras.protocols.errors import PictureError, SourceError
from ltm_ros.cameras.protocols.http_client import HttpClient, http_time
from ltm_ros.cameras.protocols.http_pictures import check_begins_as_picture
from ltm_ros.cameras.protocols.picture import CameraImage, CameraTime, Nothing, Timing, stated_number

_MOST_ENTRIES = 100_000
_MILLISECONDS = 1e11
"""An epoch beyond it is stated in milliseconds."""


class CameraListReader:
    """Reads the list, the picture, and the list again: where the list has another direction by then, the camera is
    taken to have moved. A list that has not changed is not sent again."""

    def __init__(self, config: CameraListConfig, most_bytes: int) -> None:
        self.pause = config.every
        self._config = config
        self._client = HttpClient(config, most_bytes=most_bytes)
        self._image = config.image.replace("{id}", config.id)
        self._tag: dict[str, str] = {}
        self._entry: dict[str, Any] = {}
        self._given: object = None
        """The time of the picture that was given last."""

    def read(self) -> CameraImage | Nothing:
        entry = self._listed()
        stated = entry.get(self._config.time_key)
        if stated is not None and stated == self._given:
            return Nothing.UNCHANGED
        before = reading_of(entry, self._config)
        answer = self._client.get(self._image)
        check_begins_as_picture(answer)
        entry = self._listed()
        after = reading_of(entry, self._config)
        if entry.get(self._config.time_key) != stated:
            raise PictureError("the list has a newer picture than the one that was read; the next one will be taken")
        self._given = stated
        direction = after
        if before is not None and after is not None and not at_rest(before, after, Tolerance()):
            direction = PtzReading(after.pan_deg, after.tilt_deg, after.zoom, True, after.at)
        timing = Timing(
            arrived=answer.arrived,
            asked=answer.asked,
            oldest=self._config.oldest,
            taken=time_of(stated) or http_time(answer.headers, "Last-Modified"),
            answered=http_time(answer.headers, "Date"),
        )
        return CameraImage(timing, jpeg=answer.body, direction=direction)

    def close(self) -> None:
        self._client.close()

    def _listed(self) -> dict[str, Any]:
        """The camera's entry. Raises SourceError where the list is none, or does not have it."""
        answer = self._client.get(self._config.url, self._tag)
        if answer.status == 304:
            return self._entry
        self._entry = entry_of(answer.body, self._config)
        tag = answer.headers.get("etag")
        self._tag = {} if tag is None else {"If-None-Match": tag}
        return self._entry


def entry_of(body: bytes, config: CameraListConfig) -> dict[str, Any]:
    """The camera's entry of a list, of a mapping that holds one (`cameras`, GeoJSON's `features`), or of a mapping by
    id. Raises SourceError where there is none."""
    try:
        content = json.loads(body)
    except (ValueError, RecursionError):
        raise SourceError("the list of cameras is no JSON") from None
    if isinstance(content, dict):
        if isinstance(own := content.get(config.id), dict):
            return own
        content = next((value for value in content.values() if isinstance(value, list)), None)
    if isinstance(content, list):
        for item in content[:_MOST_ENTRIES]:
            entry = item.get("properties", item) if isinstance(item, dict) else None
            if isinstance(entry, dict) and str(entry.get(config.id_key)) == config.id:
                return entry
    raise SourceError(f"the list of cameras has none whose {config.id_key} is {config.id!r}")


def reading_of(entry: dict[str, Any], config: CameraListConfig) -> PtzReading | None:
    """Where the list says that the camera looks; None where it does not say."""
    pan, tilt, zoom = (stated_number(entry.get(key)) for key in (config.pan_key, config.tilt_key, config.zoom_key))
    if pan is None or tilt is None:
        return None
    return PtzReading(pan, tilt, zoom if zoom is not None else 1.0, None, time.monotonic())


def time_of(value: Any) -> CameraTime | None:
    """Epoch seconds or milliseconds, or ISO 8601, which without a zone is UTC; whole seconds unless a fraction is
    stated."""
    number = None if isinstance(value, bool) else stated_number(value)
    if number is not None:
        epoch = number / 1000 if number > _MILLISECONDS else number
        return CameraTime(epoch, 0.001 if epoch % 1 else 1.0, "list") if 0 < epoch < _MILLISECONDS else None
    try:
        moment = datetime.fromisoformat(str(value))
        if moment.tzinfo is None:
            moment = moment.replace(tzinfo=UTC)
        return CameraTime(moment.timestamp(), 0.001 if moment.microsecond else 1.0, "list")
    except (ValueError, OverflowError):
        return None
