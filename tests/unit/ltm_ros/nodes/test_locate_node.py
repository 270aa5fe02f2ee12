"""locate: regions in, estimates and tracks out; what cannot be taken is told and changes nothing."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from geometry_msgs.msg import Point32, PointStamped, PolygonStamped
from scenes.located import CAMERA, hills, sighting
from scenes.outlets import Kept

from ltm_core.base.errors import ConfigError, LtmError, MessageError, RegionError
from ltm_core.locating.sighting import Sighting
from ltm_core.raster.dem import Dem
from ltm_core.site.site_io import load_site
from ltm_msgs_py.pose import msg_to_covariance, pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_msgs_py.stamp import make_header
from ltm_ros.launching.graph import describe
from ltm_ros.nodes.locate import LocateConfig, LocateHandler
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import (
    LOCATE_AREA,
    LOCATE_ESTIMATE,
    LOCATE_FIX,
    LOCATE_FUSED,
    LOCATE_POINT,
    LOCATE_REGION,
    LOCATE_TRACKS,
    POSED_CAMERA_INFO,
    POSED_POSE,
    camera_topic,
)

pytestmark = pytest.mark.kernel

STAMP = 1_700_000_000_000_000_000
SECOND = 1_000_000_000
FIRE = np.array([-100.0, 2480.0, 64.0])
TOWERS = {"north": (-900.0, 1300.0, 180.0), "east": (1200.0, 1700.0, 190.0)}


def write_site(folder: Path, **more: Any) -> Path:
    dem = hills()
    moved = replace(dem.geometry, x_min=dem.geometry.x_min + 4e5, y_max=dem.geometry.y_max + 38e5, crs="EPSG:32611")
    Dem(dem.elevation, moved).save(folder / "dem.tif")
    content: dict[str, Any] = {
        "name": "hollow",
        "crs": "EPSG:32611",
        "origin": [4e5, 38e5],
        "dem": {"path": "dem.tif"},
        "expert": {"curvature": False},
        "cameras": {name: {} for name in TOWERS},
    }
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(content | more))
    return path


class Running:
    def __init__(self, folder: Path, **content: Any) -> None:
        self.kept, self.health = Kept(), Health()
        tuning = {"curvature": False, "locating": {"dem_sigma": 0.5}}
        site = str(write_site(folder, locating={}, **({"expert": tuning} | content)))
        self.node = LocateHandler(LocateConfig(site=site), self.kept, self.health)
        self.kept.now = STAMP + 60 * SECOND

    def of(self, camera: str, topic: Topic) -> Topic:
        return replace(topic, name=camera_topic("hollow", camera, topic))

    def send(self, camera: str, topic: Topic, message: Any) -> None:
        self.node.subscriptions[self.of(camera, topic)](message)

    def pose(self, seen: Sighting, stamp: int = STAMP) -> None:
        self.send(seen.name, POSED_CAMERA_INFO, camera_to_msg(CAMERA, stamp, f"{seen.name}_optical"))
        self.send(seen.name, POSED_POSE, pose_to_msg(seen.pose, stamp, covariance=seen.covariance))


def seen_by(camera: str, turned_deg: float = 0.0) -> Sighting:
    return sighting(camera, TOWERS[camera], FIRE, 0.05, turned_deg)


def region(seen: Sighting, stamp: int = STAMP, size: float = 6.0, frame: str | None = None) -> PolygonStamped:
    u, v = (float(x) for x in seen.mark.pixels[0])
    message = PolygonStamped(header=make_header(stamp, f"{seen.name}_optical" if frame is None else frame))
    corners = [(u - size, v - 3 * size), (u + size, v - 3 * size), (u + size, v), (u - size, v)]
    message.polygon.points = [Point32(x=x, y=y, z=0.0) for x, y in corners]
    return message


def test_two_cameras_make_one_track(tmp_path: Path) -> None:
    running = Running(tmp_path)
    for camera in TOWERS:
        seen = seen_by(camera)
        running.pose(seen)
        running.send(camera, LOCATE_REGION, region(seen, STAMP + SECOND))
    for camera in TOWERS:
        (estimate,) = running.kept.on(running.of(camera, LOCATE_ESTIMATE))
        assert estimate.header.frame_id == "map"
        (fix,) = running.kept.on(running.of(camera, LOCATE_FIX))
        place = estimate.pose.pose.position
        x, y = load_site(running.node.config.site).frame.from_lonlat(fix.longitude, fix.latitude)
        assert (x, y) == pytest.approx((place.x, place.y), abs=0.1)
        assert fix.position_covariance[:2] == pytest.approx(estimate.pose.covariance[:2])
        (area,) = running.kept.on(running.of(camera, LOCATE_AREA))
        corners = np.array([(point.x, point.y) for point in area.polygon.points])
        assert cv2.pointPolygonTest(corners.astype(np.float32)[:, None], (place.x, place.y), False) > 0
    fused = running.kept.on(LOCATE_FUSED)[-1]
    place = fused.pose.pose.position
    assert (place.x, place.y) == pytest.approx(tuple(FIRE[:2]), abs=15)
    assert place.z == pytest.approx(FIRE[2], abs=15)
    covariance = np.array(fused.pose.covariance).reshape(6, 6)
    assert 0 < covariance[0, 0] < 400
    # The orientation is not known, and readers of poses see that.
    assert msg_to_covariance(fused) is None
    tracks = json.loads(running.kept.on(LOCATE_TRACKS)[-1].data)["features"]
    point = tracks[0]["properties"]
    assert point["seen_by"] == ["north", "east"]
    assert {view["camera"] for view in point["cameras"]} == set(TOWERS)
    assert point["place"]["mgrs"].startswith("11S")


def test_a_persons_point_enters_the_same_track(tmp_path: Path) -> None:
    running = Running(tmp_path)
    north, east = seen_by("north"), seen_by("east")
    running.pose(north)
    running.pose(east)
    running.send("north", LOCATE_REGION, region(north))
    message = PointStamped(header=make_header(STAMP + 3 * SECOND, "east_optical"))
    message.point.x, message.point.y = (float(v) for v in east.mark.pixels[0])
    running.send("east", LOCATE_POINT, message)
    properties = json.loads(running.kept.on(LOCATE_TRACKS)[-1].data)["features"][0]["properties"]
    assert properties["sources"] == ["detector", "person"]
    assert properties["track"] == 1


def test_the_pose_is_that_of_the_regions_stamp(tmp_path: Path) -> None:
    running = Running(tmp_path)
    right, away = seen_by("north"), seen_by("north", turned_deg=25.0)
    running.pose(away, STAMP - SECOND)
    running.pose(right, STAMP)
    running.pose(away, STAMP + SECOND)
    running.send("north", LOCATE_REGION, region(right, STAMP))
    estimate = running.kept.on(running.of("north", LOCATE_ESTIMATE))[-1]
    here = np.array([estimate.pose.pose.position.x, estimate.pose.pose.position.y])
    towards = FIRE[:2] - TOWERS["north"][:2]
    off = here - TOWERS["north"][:2]
    assert abs(np.degrees(np.arctan2(*off) - np.arctan2(*towards))) < 1.5


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        ({"frame": "map"}, MessageError, "expected 'north_optical'"),
        ({"stamp": STAMP - 3600 * SECOND}, MessageError, "no pose at this time"),
        ({"size": 200.0}, RegionError, "is outside the image"),
    ],
)
def test_bad_regions_change_nothing(tmp_path: Path, change: dict[str, Any], error: type[LtmError], said: str) -> None:
    running = Running(tmp_path)
    seen = seen_by("north")
    running.pose(seen)
    message = region(seen, **change)
    if "size" in change:
        for point in message.polygon.points:
            point.y -= 3000.0
    with pytest.raises(error, match=said):
        running.send("north", LOCATE_REGION, message)
    assert running.kept.on(LOCATE_FUSED) == []
    running.send("north", LOCATE_REGION, region(seen))
    assert len(running.kept.on(LOCATE_FUSED)) == 1


def test_what_the_site_masks_is_not_located(tmp_path: Path) -> None:
    seen = seen_by("north")
    u, v = (float(x) for x in seen.mark.pixels[0])
    mast = [{"polygon": [[u - 9, v - 40], [u + 9, v - 40], [u + 9, v + 9], [u - 9, v + 9]]}]
    running = Running(tmp_path, cameras={"north": {"mask": mast}, "east": {}})
    running.pose(seen)
    with pytest.raises(RegionError, match="masked"):
        running.send("north", LOCATE_REGION, region(seen))
    aside = region(seen)
    for point in aside.polygon.points:
        point.x += 60.0
    running.send("north", LOCATE_REGION, aside)
    assert len(running.kept.on(LOCATE_FUSED)) == 1


def places(running: Running) -> list[dict[str, Any]]:
    """What is said last of each track."""
    features = json.loads(running.kept.on(LOCATE_TRACKS)[-1].data)["features"]
    return [one["properties"] for one in features if one["properties"]["role"] == "place"]


def test_cameras_of_which_one_is_turned_disagree(tmp_path: Path) -> None:
    towers = TOWERS | {"west": (-1300.0, 900.0, 120.0)}
    running = Running(tmp_path, cameras={name: {} for name in towers})
    fire = np.array([-100.0, 1900.0, 0.0])
    for name, at in towers.items():
        seen = sighting(name, at, fire, 0.05, 2.0 if name == "west" else 0.0)
        running.pose(seen)
        message = PointStamped(header=make_header(STAMP, f"{name}_optical"))
        message.point.x, message.point.y = (float(v) for v in seen.mark.pixels[0])
        running.send(name, LOCATE_POINT, message)
    found = places(running)
    assert [{*place["seen_by"]} for place in found] == [{"north", "east"}, {"west"}]
    assert {place["disagrees"] for place in found} == {"east, north, west"}
    assert running.health.summary()["noted.cameras_disagree"] == "1"


def test_too_many_points_and_no_points_are_told(tmp_path: Path) -> None:
    running = Running(tmp_path)
    seen = seen_by("north")
    message = region(seen)
    message.polygon.points = message.polygon.points * 300
    with pytest.raises(MessageError, match="1 to 1000 points, got 1200"):
        running.send("north", LOCATE_REGION, message)
    message.polygon.points = []
    with pytest.raises(MessageError, match="got 0"):
        running.send("north", LOCATE_REGION, message)
    with pytest.raises(MessageError, match="pose has not been received"):
        running.send("north", LOCATE_REGION, region(seen))


def test_a_stamp_of_tomorrow_is_refused(tmp_path: Path) -> None:
    running = Running(tmp_path)
    seen = seen_by("north")
    running.pose(seen)
    running.send("north", LOCATE_REGION, region(seen, STAMP + 86_400 * SECOND))
    assert running.kept.on(LOCATE_FUSED) == []


def test_a_region_without_a_stamp_after_the_clock_was_set_back(tmp_path: Path) -> None:
    """It is of the pose that was told last; one of the time before would be of the future, and end every track."""
    running = Running(tmp_path)
    seen, later = seen_by("north"), STAMP + 3 * 3600 * SECOND
    other = seen_by("east")
    running.pose(other)
    running.send("east", LOCATE_REGION, region(other, STAMP))
    running.pose(seen, later)
    running.send("north", LOCATE_REGION, region(seen, 0))
    assert running.health.dropped == {"future": 1}
    running.pose(seen, STAMP + SECOND)
    running.send("north", LOCATE_REGION, region(seen, 0))
    assert running.health.dropped == {"future": 1}
    (point,) = places(running)
    assert (point["seen_by"], point["last_ns"]) == (["east", "north"], STAMP + SECOND)


def test_a_calibration_that_no_picture_may_have_is_not_taken(tmp_path: Path) -> None:
    """Its mask would be made in that size: four gigabytes."""
    mask = [{"class": "caption", "polygon": [[0, 0], [80, 0], [80, 30], [0, 30]]}]
    running = Running(
        tmp_path, cameras={name: {"mask": mask} for name in TOWERS}, expert={"limits": {"pixels": 3_000_000}}
    )
    seen = seen_by("north")
    running.pose(seen)
    huge = camera_to_msg(replace(CAMERA, width=65_535, height=65_535), STAMP, "north_optical")
    running.send("north", POSED_CAMERA_INFO, huge)
    assert running.health.dropped == {"too_large": 1}
    assert "calibration of north of 65535 x 65535 pixels; the maximum is 3000000" in running.health.last_error
    running.send("north", LOCATE_REGION, region(seen, STAMP))
    assert len(places(running)) == 1


def test_the_node_is_there_where_the_site_asks_for_it(tmp_path: Path) -> None:
    path = write_site(tmp_path)
    assert "locate" not in [node.label for node in describe(load_site(path), path)]
    with pytest.raises(ConfigError, match="no section `locating`"):
        LocateHandler(LocateConfig(site=str(path)), Kept(), Health())
    path = write_site(tmp_path, locating={})
    graph = describe(load_site(path), path)
    assert graph.node("locate").namespace == "/hollow"
    with pytest.raises(ConfigError, match="is the name of a node"):
        load_site(write_site(tmp_path, cameras={"locate": {}}))
