"""Send marks that a user clicks on the status page to `locate`, and return its places."""

import threading
from collections.abc import Callable, Sequence
from http import HTTPStatus
from typing import Any

from geometry_msgs.msg import PointStamped
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from rclpy.node import Node

from ltm_core.base.strict_model import StrictModel, problem_text
from ltm_msgs_py.json_topics import LocateTracks
from ltm_msgs_py.stamp import make_header
from ltm_ros.cameras.protocols.picture import difference_deg
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.outlet_node import stream_qos
from ltm_ros.runtime.topics import LOCATE_POINT, LOCATE_TRACKS, camera_topic, site_topic
from ltm_ros.runtime.web_server import WebResponse
from ltm_ros.tower.last_pictures import CameraPicture

SAME_DEG = 0.1
"""Largest change of a viewing direction in degrees at which an earlier mark is drawn on a camera's image."""


class PageMark(StrictModel):
    """A clicked mark. `stamp`: seconds, of the shown image; `across`, `down`: shares of its width and height, from the
    upper left corner."""

    camera: str
    stamp: float
    across: float = Field(ge=0, le=1)
    down: float = Field(ge=0, le=1)


class _Told(BaseModel):
    """The part of `locate/tracks` that is used here."""

    model_config = ConfigDict(allow_inf_nan=False)


class _Name(_Told):
    mgrs: str | None
    lon: float
    lat: float
    elevation: float | None


class _Ellipse(_Told):
    share: float
    semi_major: float | None
    semi_minor: float | None


class _Mark(_Told):
    camera: str
    u: float
    v: float
    azimuth_deg: float
    pitch_deg: float


class _Place(_Told):
    track: int
    marks: list[_Mark]
    last_ns: int
    place: _Name
    ellipses: list[_Ellipse]
    seen_by: list[str]
    sources: list[str]
    disagrees: str | None


class Marks:
    """`take`, `places` and `wrong` may be called from any thread.

    `shown`: the image of a camera of a stamp in seconds, by default the newest; None: the page has not shown it lately.
    """

    def __init__(
        self,
        node: Node,
        site: str,
        cameras: Sequence[str],
        shown: Callable[[str, float | None], CameraPicture | None],
        health: Health,
    ) -> None:
        self._shown, self._health = shown, health
        self._publishers = {
            name: node.create_publisher(LOCATE_POINT.type, camera_topic(site, name, LOCATE_POINT), stream_qos())
            for name in cameras
        }
        self._places: list[_Place] = []
        self._lock = threading.Lock()
        node.create_subscription(
            LOCATE_TRACKS.type, site_topic(site, LOCATE_TRACKS), self._hear, stream_qos(LOCATE_TRACKS.latched, 1)
        )

    def take(self, body: bytes) -> WebResponse:
        """Take a request, a `PageMark` in JSON, and publish the mark; `locate` reports its result itself."""
        try:
            mark = PageMark.model_validate_json(body)
        except ValidationError as error:
            return WebResponse.error(HTTPStatus.BAD_REQUEST, f"invalid mark: {problem_text(error)}")
        picture = self._shown(mark.camera, mark.stamp) if mark.camera in self._publishers else None
        if picture is None:
            return WebResponse.error(HTTPStatus.NOT_FOUND, "the page has no image of this camera and time: reload it")
        u, v = picture.pixel(mark.across, mark.down)
        point = PointStamped(header=make_header(picture.stamp_ns, f"{mark.camera}_optical"))
        point.point.x, point.point.y = u, v
        self._publishers[mark.camera].publish(point)
        return WebResponse.json({"u": round(u, 1), "v": round(v, 1)})

    def places(self) -> list[dict[str, Any]]:
        """Return the site's tracks, newest first, as `locate` published them; `marks` are those that lie on the images
        of the page, as shares of their width and height."""
        with self._lock:
            places = list(self._places)
        return [place.model_dump() | {"marks": self._drawn(place), "mark_count": len(place.marks)} for place in places]

    def on_map(self) -> list[tuple[int, float, float]]:
        """Return number, longitude and latitude of each track."""
        with self._lock:
            return [(place.track, place.place.lon, place.place.lat) for place in self._places]

    def _drawn(self, place: _Place) -> list[dict[str, Any]]:
        drawn = []
        for mark in place.marks:
            picture = self._shown(mark.camera, None)
            if picture is None:
                continue
            azimuth, pitch, _ = picture.pose.angles_deg
            if max(difference_deg(azimuth, mark.azimuth_deg), abs(pitch - mark.pitch_deg)) < SAME_DEG:
                across, down = (mark.u + 0.5) / picture.camera.width, (mark.v + 0.5) / picture.camera.height
                drawn.append({"camera": mark.camera, "across": across, "down": down})
        return drawn

    def wrong(self) -> list[str]:
        """Return sentences about cameras that disagree, if any."""
        with self._lock:
            told = [(place.disagrees, place.track) for place in self._places if place.disagrees]
        return [f"cameras {names} disagree about place {number}: check their mounts" for names, number in told]

    def _hear(self, message: Any) -> None:
        try:
            told = LocateTracks.model_validate_json(message.data)
            about = (one.properties for one in told.features)
            found = [_Place.model_validate(one) for one in about if one.get("role") == "place"]
        except ValidationError as error:
            self._health.drop("message", f"{LOCATE_TRACKS.name}: invalid message of `locate` ({problem_text(error)})")
            return
        with self._lock:
            self._places = sorted(found, key=lambda place: -place.last_ns)
