import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from std_msgs.msg import String

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_ros.runtime.health import Health
from ltm_ros.tower.last_pictures import CameraPicture
from ltm_ros.tower.marks import Marks

STAMP = 1_700_000_000_123_456_789


class Graph:
    """A node's part in it: what was published, by topic, and who listens."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, Any]] = []
        self.heard: dict[str, Callable[[Any], None]] = {}

    def create_publisher(self, _: type, topic: str, __: Any) -> Any:
        return SimpleNamespace(publish=lambda message: self.sent.append((topic, message)))

    def create_subscription(self, _: type, topic: str, callback: Callable[[Any], None], __: Any) -> None:
        self.heard[topic] = callback


def picture(width: int = 1920, height: int = 1080) -> CameraPicture:
    """As it came; thinned by `small`."""
    return CameraPicture(
        "north",
        STAMP,
        np.zeros((height, width, 3), np.uint8),
        np.zeros((height, width), np.uint8),
        np.zeros((height, width), np.float32),
        Camera.from_fov(width, height, 50.0),
        Pose.from_angles((0.0, 0.0, 0.0), 0.0, 0.0),
    )


@pytest.fixture
def graph() -> Graph:
    return Graph()


@pytest.fixture
def health() -> Health:
    return Health()


@pytest.fixture
def marks(graph: Graph, health: Health) -> Marks:
    small = picture().small()

    def shown(camera: str, stamp_s: float | None) -> CameraPicture | None:
        known = camera == "north" and (stamp_s is None or abs(stamp_s - STAMP / 1e9) < 1e-3)
        return small if known else None

    return Marks(graph, "ridge", ["north", "east"], shown, health)


def body(**keys: Any) -> bytes:
    return json.dumps({"camera": "north", "stamp": STAMP / 1e9, "across": 0.5, "down": 0.25} | keys).encode()


def test_a_click_is_a_pixel_of_the_cameras_own_picture(graph: Graph, marks: Marks) -> None:
    """The page shows it 800 pixels wide."""
    answer = marks.take(body())
    assert answer.status == 200
    ((topic, point),) = graph.sent
    assert topic == "/ridge/north/locate/point"
    assert point.header.frame_id == "north_optical"
    assert point.header.stamp.sec * 10**9 + point.header.stamp.nanosec == STAMP
    assert (point.point.x, point.point.y) == (0.5 * 1920 - 0.5, 0.25 * 1080 - 0.5)
    assert json.loads(answer.body) == {"u": 959.5, "v": 269.5}


@pytest.mark.parametrize(
    ("sent", "status", "said"),
    [
        (b"not json", 400, "invalid mark"),
        (body(across=1.5), 400, "across"),
        (body(across=float("nan")), 400, "invalid mark"),
        (body(more=1), 400, "more"),
        (body(camera="../../etc"), 404, "no image"),
        (body(camera="east"), 404, "no image"),
        (body(stamp=STAMP / 1e9 - 5), 404, "no image"),
    ],
)
def test_what_is_no_mark_is_told_and_not_sent(graph: Graph, marks: Marks, sent: bytes, status: int, said: str) -> None:
    answer = marks.take(sent)
    assert answer.status == status
    assert said in answer.body.decode()
    assert graph.sent == []


MARK = {"camera": "north", "u": 959.5, "v": 269.5, "azimuth_deg": 359.95, "pitch_deg": 0.0}


def tracks(*last_ns: int, lon: float = -117.2, disagrees: object = None) -> String:
    """As `locate` tells of them, numbered from 1 on, each with an ellipse as a feature of its own."""
    features: list[Any] = []
    for number, last in enumerate(last_ns, start=1):
        place = {"mgrs": "11S MB 80574 50576", "lon": lon, "lat": 37.5, "elevation": None, "crs": "EPSG:32611"}
        ellipse = {"share": 0.95, "semi_major": 30.0, "semi_minor": 9.0, "azimuth_deg": 12.0}
        about = {"role": "place", "track": number, "last_ns": last, "place": place, "ellipses": [ellipse]}
        about |= {
            "marks": [MARK, *(MARK | {"azimuth_deg": off} for off in (7.0, 9.0)), MARK | {"camera": "east"}],
            "seen_by": ["north"],
            "sources": ["person"],
            "disagrees": disagrees,
            "smoke": True,
        }
        point = {"type": "Point", "coordinates": [lon, 37.5]}
        for properties in (about, {"role": "ellipse", "share": 0.95}):
            features.append({"type": "Feature", "geometry": point, "properties": properties})
    return String(data=json.dumps({"version": 1, "stamp_ns": 5, "features": features}))


def test_a_turned_camera_is_told_in_words_until_it_is_not_named_any_more(graph: Graph, marks: Marks) -> None:
    hear = graph.heard["/ridge/locate/tracks"]
    assert marks.wrong() == []
    hear(tracks(5, disagrees="east, north"))
    (said,) = marks.wrong()
    assert "east, north" in said
    assert "place 1" in said
    hear(tracks(6))
    assert marks.wrong() == []


@pytest.mark.parametrize(
    "message",
    [
        String(data="no JSON"),
        String(data='{"features": 3}'),
        String(data="[" * 100_000),
        tracks(7, lon=np.nan),
        tracks(7, disagrees=3),
    ],
)
def test_what_is_no_word_of_locate_is_counted_and_changes_nothing(
    graph: Graph, marks: Marks, health: Health, message: String
) -> None:
    """Whoever is on the machine can publish there."""
    graph.heard["/ridge/locate/tracks"](tracks(5))
    before = marks.places()
    graph.heard["/ridge/locate/tracks"](message)
    assert health.dropped == {"message": 1}
    assert marks.places() == before


def test_a_mark_is_drawn_while_its_camera_looks_where_it_did(graph: Graph, marks: Marks) -> None:
    graph.heard["/ridge/locate/tracks"](tracks(5))
    (place,) = marks.places()
    assert (place["mark_count"], [mark["camera"] for mark in place["marks"]]) == (4, ["north"])
