import io
import tracemalloc
from array import array
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
import yaml
from scenes.outlets import Kept
from scenes.rasters import rough_terrain
from scenes.transforms import LINK_OPTICAL, transform_to_msg

from ltm_core.base.errors import CameraError, ImageError, PoseError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_msgs_py.bag.cdr import Transforms
from ltm_msgs_py.image import compressed_to_msg, encode_rgb, image_to_msg, msg_to_rgb
from ltm_msgs_py.pose import msg_to_pose, msg_to_transform, pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg, msg_to_camera
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.nodes.capture import CaptureConfig, CaptureHandler
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import (
    CAMERA_INFO,
    IMAGE_RAW,
    POSE,
    POSED_CAMERA_INFO,
    POSED_FIX,
    POSED_IMAGE,
    POSED_POSE,
)

CAMERA = Camera(12, 7, 10.0, 11.0, 5.5, 3.0)
S = 10**9
RNG = np.random.default_rng(5)
PHOTO = RNG.integers(0, 255, (7, 12, 3), dtype=np.uint8)


def image(stamp: int, data: bytes | None = None) -> Any:
    message = compressed_to_msg(encode_rgb(PHOTO, "png"), "png", stamp, "driver_frame")
    if data is not None:
        message.data = array("B", data)
    return message


def info(stamp: int, fx: float = 10.0) -> Any:
    return camera_to_msg(Camera(12, 7, fx, 11.0, 5.5, 3.0), stamp, "driver_frame")


def at(x: float) -> Pose:
    return Pose.from_angles((x, 2.0, 3.0), 40.0, -5.0, 1.0)


def pose(stamp: int, x: float = 1.0) -> Any:
    return pose_to_msg(at(x), stamp, "map", np.diag([1.0, 2, 3, 4, 5, 6]))


def cut_jpeg() -> bytes:
    """Return a JPEG of the camera's size whose data end early, though it has an end marker."""
    buffer = io.BytesIO()
    PIL.Image.fromarray(PHOTO).save(buffer, "JPEG", progressive=True)
    return buffer.getvalue()[: buffer.tell() * 3 // 4] + b"\xff\xd9"


@pytest.fixture
def site(tmp_path: Path) -> Callable[..., Path]:
    """Writes a site of one camera `eye` with these settings."""

    def write(**camera: Any) -> Path:
        geometry = GridGeometry(500_000.0, 4_000_600.0, 5.0, 130, 120, "EPSG:32611")
        Dem(rough_terrain(4, (120, 130)).elevation, geometry).save(tmp_path / "dem.tif")
        content = {
            "name": "ridge",
            "crs": "EPSG:32611",
            "origin": [500_000.0, 4_000_000.0],
            "dem": {"path": "dem.tif"},
            "cameras": {"eye": camera},
        }
        (tmp_path / "site.yaml").write_text(yaml.safe_dump(content))
        return tmp_path / "site.yaml"

    return write


@pytest.fixture
def capture_of(site: Callable[..., Path]) -> Callable[..., tuple[CaptureHandler, Kept, Health]]:
    def make(camera: dict[str, Any] | None = None, **parameters: Any) -> tuple[CaptureHandler, Kept, Health]:
        outlet, health = Kept(), Health()
        outlet.now = 200 * S  # as a simulation's clock, which begins at zero
        config = CaptureConfig(site=str(site(**(camera or {}))), camera="eye", **parameters)
        return CaptureHandler(config, outlet, health), outlet, health

    return make


CaptureOf = Callable[..., tuple[CaptureHandler, Kept, Health]]


@pytest.mark.parametrize("order", ["ipc", "icp", "pic", "pci", "cip", "cpi"])
def test_leaves_when_the_last_part_comes(capture_of: CaptureOf, order: str) -> None:
    capture, outlet, health = capture_of()
    feed = {
        "i": lambda: capture.on_image(image(S)),
        "p": lambda: capture.subscriptions[POSE](pose(S)),
        "c": lambda: capture.on_camera_info(info(S)),
    }
    for part in order[:2]:
        feed[part]()
    assert outlet.sent == []
    feed[order[2]]()
    assert [topic for topic, _ in outlet.sent] == [POSED_CAMERA_INFO, POSED_POSE, POSED_FIX, POSED_IMAGE]
    assert [stamp_of(message) for _, message in outlet.sent] == [S] * 4
    np.testing.assert_array_equal(msg_to_rgb(outlet.on(POSED_IMAGE)[0]), PHOTO)
    assert msg_to_camera(outlet.on(POSED_CAMERA_INFO)[0]) == CAMERA
    sent = outlet.on(POSED_POSE)[0]
    np.testing.assert_allclose(msg_to_pose(sent, "map").rotation, at(1.0).rotation, atol=1e-12)
    assert sent.pose.covariance.reshape(6, 6).diagonal().tolist() == [1, 2, 3, 4, 5, 6]
    assert {outlet.on(topic)[0].header.frame_id for topic in (POSED_IMAGE, POSED_CAMERA_INFO)} == {"eye_optical"}
    assert health.dropped == {}


def test_calibration_is_the_newest_up_to_the_image(capture_of: CaptureOf) -> None:
    capture, outlet, _ = capture_of()
    for stamp, fx in ((10 * S, 10.0), (30 * S, 30.0), (20 * S, 20.0)):
        capture.on_camera_info(info(stamp, fx))
    for stamp in (5 * S, 25 * S, 20 * S, 99 * S):
        capture.subscriptions[POSE](pose(stamp))
        capture.on_image(image(stamp))
    # An image from before all calibrations takes the first.
    assert [m.k[0] for m in outlet.on(POSED_CAMERA_INFO)] == [10.0, 20.0, 20.0, 30.0]


@pytest.mark.parametrize(
    ("others", "expected"),
    [
        ({-1: 3.0}, None),
        ({1: 3.0}, None),
        ({-1: 1.0, 250_000_000: 3.0}, None),
        ({-50_000_000: 1.0, 150_000_000: 3.0}, 1.5),
        ({-200_000_000: 0.0, -50_000_000: 1.0, 150_000_000: 3.0, 199_000_000: 9.0}, 1.5),
        ({-50_000_000: 1.0, 0: 7.0, 150_000_000: 3.0}, 7.0),
    ],
    ids=["before", "after", "too far apart", "between", "the nearest two", "its own"],
)
def test_pose_has_the_stamp_or_is_interpolated(
    capture_of: CaptureOf, others: dict[int, float], expected: float | None
) -> None:
    """Poses at the offsets in ns from the image's stamp, with x, and azimuths of 40 degrees + x."""
    capture, outlet, _ = capture_of()
    capture.on_camera_info(info(0))
    for offset, x in others.items():
        turned = Pose.from_angles((x, 2.0, 3.0), 40.0 + x, 0.0, 0.0)
        capture.subscriptions[POSE](pose_to_msg(turned, S + offset, "map", np.diag([1.0, 2, 3, 4, 5, 6])))
    capture.on_image(image(S))
    if expected is None:
        assert outlet.sent == []
        return
    (sent,) = outlet.on(POSED_POSE)
    assert stamp_of(sent) == S
    assert sent.pose.pose.position.x == pytest.approx(expected)
    np.testing.assert_allclose(
        msg_to_pose(sent).rotation, Pose.from_angles((0, 0, 0), 40.0 + expected, 0.0, 0.0).rotation, atol=1e-12
    )


def test_image_waits_so_long_and_is_counted(capture_of: CaptureOf) -> None:
    capture, outlet, health = capture_of(max_wait=2.0)
    capture.on_camera_info(info(0))
    capture.on_image(image(S))
    for _ in range(3):
        capture.tick(0.6)
    capture.on_image(image(2 * S))
    assert health.dropped == {}
    capture.tick(0.6)
    assert health.dropped == {"no_pose": 1}
    assert f"image of stamp {S} ns has no pose (waited 2 s)" in health.last_error
    capture.subscriptions[POSE](pose(S))
    capture.subscriptions[POSE](pose(2 * S))
    assert outlet.stamps(POSED_IMAGE) == [2 * S]


def test_duplicates_and_disorder(capture_of: CaptureOf) -> None:
    capture, outlet, health = capture_of()
    capture.on_camera_info(info(0))
    for stamp in (2 * S, S, 2 * S, 3 * S):
        capture.subscriptions[POSE](pose(stamp))
        capture.on_image(image(stamp))
    assert outlet.stamps(POSED_IMAGE) == [2 * S, S, 3 * S]
    assert health.dropped == {"duplicate": 1}
    assert health.summary()["noted.out_of_order"] == "1"


def test_an_image_that_is_the_last_one_again_is_no_new_one(capture_of: CaptureOf) -> None:
    """Where the site says so: a test's camera may well send one picture all the time."""
    other = encode_rgb(255 - PHOTO, "png")
    for told, left in ((False, [1, 2, 3, 4, 5]), (True, [1, 3, 4])):
        capture, outlet, health = capture_of(drop_repeated=told)
        capture.on_camera_info(info(0))
        for second, data in enumerate((None, None, other, None, None), start=1):
            capture.subscriptions[POSE](pose(second * S))
            capture.on_image(image(second * S, data))
        assert [stamp // S for stamp in outlet.stamps(POSED_IMAGE)] == left
        assert health.dropped == ({"repeated": 2} if told else {})


@pytest.mark.parametrize("data", [b"garbage", cut_jpeg()])
def test_broken_image_does_not_hold_back_the_others(capture_of: CaptureOf, data: bytes) -> None:
    capture, outlet, health = capture_of()
    for stamp in (S, 2 * S, 3 * S, 4 * S):
        capture.subscriptions[POSE](pose(stamp))
        capture.on_image(image(stamp, data if stamp in (S, 3 * S) else None))
    with pytest.raises(ImageError, match=r"neither jpeg nor png|truncated"):
        capture.on_camera_info(info(0))
    assert outlet.stamps(POSED_IMAGE) == [2 * S, 4 * S]
    # The one that is raised is counted by who called.
    assert health.dropped == {"image": 1}
    capture.finish()
    assert health.dropped == {"image": 1}


def test_bad_parts_are_refused_and_leave_nothing(capture_of: CaptureOf) -> None:
    capture, outlet, _ = capture_of()
    bad_pose, bad_info = pose(S), info(S)
    bad_pose.pose.pose.position.y = float("nan")
    bad_info.k[0] = 0.0
    with pytest.raises(PoseError):
        capture.subscriptions[POSE](bad_pose)
    with pytest.raises(CameraError, match="uncalibrated"):
        capture.on_camera_info(bad_info)
    capture.on_image(image(S))
    assert outlet.sent == []
    capture.subscriptions[POSE](pose(S))
    with pytest.raises(ImageError, match="image of eye is 12 x 7 pixels, but its calibration is for 13 x 7"):
        capture.on_camera_info(camera_to_msg(Camera.from_fov(13, 7, 50.0), S, "x"))
    assert outlet.sent == []


def test_site_file_may_give_pose_and_calibration(capture_of: CaptureOf) -> None:
    calibration = {"width": 12, "height": 7, "fx": 9.0}
    where = {"x": 500_321.0, "y": 4_000_123.0, "height_above_ground": 8.0, "azimuth_deg": 70.0}
    capture, outlet, _ = capture_of({"image": "raw", "calibration": calibration, "pose": where})
    assert {*capture.subscriptions} == {IMAGE_RAW}
    capture.on_image(image_to_msg(PHOTO[..., ::-1].copy(), "bgr8", S, "driver_frame"))
    np.testing.assert_array_equal(msg_to_rgb(outlet.on(POSED_IMAGE)[0]), PHOTO)
    sent = msg_to_pose(outlet.on(POSED_POSE)[0], "map")
    ground = Dem.open(Path(capture.config.site).parent / "dem.tif").elevation_at(500_321.0, 4_000_123.0)
    np.testing.assert_allclose(sent.position, [321.0, 123.0, float(ground) + 8.0], atol=1e-6)
    assert msg_to_camera(outlet.on(POSED_CAMERA_INFO)[0]) == Camera(12, 7, 9.0, 9.0, 5.5, 3.0)


def test_subscribes_to_the_names_that_the_site_file_gives(capture_of: CaptureOf) -> None:
    capture, outlet, _ = capture_of({"topics": {"image": "/rig/image_raw", "pose": "/odom"}})
    topics = {topic.name: topic for topic in capture.subscriptions}
    assert {*topics} == {"/rig/image_raw", "/odom", CAMERA_INFO.name, "pose"}
    assert (topics["/rig/image_raw"].type, topics["/odom"].counted_name) == (IMAGE_RAW.type, POSE.name)
    capture.on_camera_info(info(0))
    capture.subscriptions[topics["/odom"]](pose(S))
    capture.subscriptions[topics["/rig/image_raw"]](image_to_msg(PHOTO, "rgb8", S, "c"))
    assert outlet.stamps(POSED_IMAGE) == [S]


@pytest.mark.parametrize("raw_first", [True, False])
def test_takes_either_kind_of_image_and_a_frame_of_both_once(capture_of: CaptureOf, raw_first: bool) -> None:
    capture, outlet, health = capture_of()
    capture.on_camera_info(info(0))
    for stamp in (S, 2 * S):
        capture.subscriptions[POSE](pose(stamp))
        for raw in (raw_first, not raw_first):
            capture.on_image(image_to_msg(PHOTO, "rgb8", stamp, "c") if raw else image(stamp))
    assert outlet.stamps(POSED_IMAGE) == [S, 2 * S]
    for sent in outlet.on(POSED_IMAGE):
        np.testing.assert_array_equal(msg_to_rgb(sent), PHOTO)
    assert health.dropped == {}


def offered(capture: CaptureHandler, *stamps: int, size: int = 0) -> None:
    capture.on_camera_info(info(0))
    for stamp in stamps:
        capture.subscriptions[POSE](pose(stamp))
        capture.on_image(image(stamp, encode_rgb(PHOTO, "png") + bytes(size)))


def test_only_the_newest_waits_and_without_others_none_does(capture_of: CaptureOf) -> None:
    capture, outlet, health = capture_of()
    outlet.more = True
    offered(capture, S, 2 * S, 6 * S, 5 * S)
    assert (outlet.stamps(POSED_IMAGE), health.summary()["waiting"]) == ([], "1")
    capture.idle()
    for topic in (POSED_IMAGE, POSED_CAMERA_INFO, POSED_POSE):
        assert outlet.stamps(topic) == [6 * S], "the newest by stamp"
    assert health.dropped == {"shed": 3}
    outlet.more = False
    offered(capture, 7 * S, 8 * S)
    assert outlet.stamps(POSED_IMAGE) == [6 * S, 7 * S, 8 * S]


def test_a_recording_waits_in_order_bounded_in_bytes(capture_of: CaptureOf) -> None:
    capture, outlet, health = capture_of(shed=False)
    outlet.more = True
    offered(capture, *(number * S for number in (1, 2, 3, 5, 4, 6, 7)), size=25 << 20)
    assert (health.summary()["waiting"], health.dropped) == ("5", {"shed": 2})
    for _ in range(4):
        capture.idle()
    assert [stamp // S for stamp in outlet.stamps(POSED_IMAGE)] == [3, 5, 4, 6]
    capture.finish()
    assert (health.summary()["waiting"], health.dropped) == ("0", {"shed": 3})


HUGE = np.finfo(np.float64).max


def posed_covariances(capture: CaptureHandler, outlet: Kept, *matrices: Any) -> list[Any]:
    """What leaves for frames whose poses come with these covariances."""
    capture.on_camera_info(info(0))
    for number, matrix in enumerate(matrices, start=1):
        message = pose(number * S)
        message.pose.covariance = np.asarray(matrix, np.float64).ravel()
        capture.subscriptions[POSE](message)
        capture.on_image(image(number * S))
    return [message.pose.covariance.reshape(6, 6) for message in outlet.on(POSED_POSE)]


def test_covariances_that_say_unknown_leave_as_what_the_site_assumes(capture_of: CaptureOf) -> None:
    capture, outlet, health = capture_of()
    partly, minus = np.diag([1.0, 2, 3, HUGE, HUGE, HUGE]), np.zeros((6, 6))
    minus[0, 0] = -1.0
    left = posed_covariances(capture, outlet, np.zeros((6, 6)), np.diag([HUGE] * 6), minus, partly)
    assumed = np.diag([0.5**2] * 3 + [np.radians(0.3) ** 2] * 3)
    assert not left[0].any(), "zeros go on as they are: every node knows them for unknown"
    np.testing.assert_allclose(left[1], assumed)
    np.testing.assert_allclose(left[2], assumed)
    np.testing.assert_allclose(left[3].diagonal(), [1, 2, 3, *assumed.diagonal()[3:]])
    assert health.summary()["noted.unknown_covariance"] == "3"
    assert health.dropped == {}


@pytest.mark.parametrize("bad", [np.diag([np.nan] * 6), np.diag([1.0, 1, 1, -2, 1, 1]), np.triu(np.ones((6, 6)))])
def test_covariances_that_are_none_are_refused_with_their_pose(capture_of: CaptureOf, bad: Any) -> None:
    capture, outlet, _ = capture_of()
    with pytest.raises(PoseError, match="pose covariance"):
        posed_covariances(capture, outlet, bad)
    assert outlet.sent == []


@pytest.fixture
def grown() -> Iterator[Callable[[], int]]:
    """The most bytes that Python and NumPy have held since the fixture was made, beyond what they held then."""
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    yield lambda: tracemalloc.get_traced_memory()[1] - before
    tracemalloc.stop()


def refuse_to_decode(monkeypatch: pytest.MonkeyPatch) -> None:
    def decode(*_: object) -> Any:
        raise AssertionError("decoded")

    monkeypatch.setattr("cv2.imdecode", decode)


def test_images_that_state_too_many_pixels_are_not_decoded(
    capture_of: CaptureOf, grown: Callable[[], int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """79 megapixels of one colour, in some hundred kilobytes."""
    capture, outlet, health = capture_of()
    refuse_to_decode(monkeypatch)
    grey = PIL.Image.new("L", (10_000, 7_900), 128)
    for number, kind in enumerate(("jpeg", "png"), start=1):
        buffer = io.BytesIO()
        grey.save(buffer, kind)
        bomb = image(number * S, buffer.getvalue())
        capture.on_camera_info(info(0))
        capture.subscriptions[POSE](pose(number * S))
        before = grown()
        capture.on_image(bomb)
        assert grown() - before < 40 << 20, "decoded by another way: 79 MB"
    assert outlet.sent == []
    assert health.dropped == {"too_large": 2}
    assert "10000 x 7900 pixels; the maximum is 12600000" in health.last_error


def test_images_of_too_many_bytes_do_not_wait(capture_of: CaptureOf, site: Callable[..., Path]) -> None:
    capture, _, health = capture_of()
    capture.on_image(image(S, bytes(33 << 20)))
    assert health.dropped == {"too_large": 1}
    assert "34603008" in health.last_error
    capture.finish()
    assert health.dropped == {"too_large": 1}, "it waits for nothing"
    raw, _, health = capture_of({"image": "raw"})
    vast = image_to_msg(PHOTO, "rgb8", S, "driver_frame")
    vast.width, vast.height = 12_000, 9_000
    padded = image_to_msg(PHOTO, "rgb8", S, "driver_frame")
    padded.data = array("B", bytes(65_000_000))
    for message in (vast, padded):
        raw.on_image(message)
    assert health.dropped == {"too_large": 2}


def test_calibrations_of_too_many_pixels_are_dropped(capture_of: CaptureOf) -> None:
    capture, _, health = capture_of()
    capture.on_camera_info(camera_to_msg(Camera.from_fov(12_000, 9_000, 50.0), S, "x"))
    assert health.dropped == {"too_large": 1}
    assert "camera_info of 12000 x 9000 pixels" in health.last_error
    capture.subscriptions[POSE](pose(S))
    capture.on_image(image(S))
    capture.finish()
    assert health.dropped == {"too_large": 1, "no_calibration": 1}


def test_images_that_wait_hold_bounded_bytes(capture_of: CaptureOf) -> None:
    """25 messages of 30 MB whose poses never come."""
    capture, _, health = capture_of(max_waiting=30)
    for number in range(1, 26):
        capture.on_image(image(number * S, bytes(30 << 20)))
    assert health.dropped == {"no_pose": 21}, "four of 30 MB are within 128 MB"
    assert "MB of data are queued" in health.last_error


@pytest.fixture
def with_tf(monkeypatch: pytest.MonkeyPatch) -> tuple[Topic, Topic]:
    """tf2_msgs as if it were installed."""
    topics = Topic("/tf", Transforms), Topic("/tf_static", Transforms, latched=True)
    for name, topic in zip(("TF", "TF_STATIC"), topics, strict=True):
        monkeypatch.setattr(f"ltm_ros.nodes.capture.{name}", topic)
    return topics


def test_a_pose_from_live_transforms_and_frames_for_others(capture_of: CaptureOf, with_tf: tuple[Topic, Topic]) -> None:
    """The pose between two transforms goes to the image; the frame sent is the images' own; ours are published."""
    capture, outlet, health = capture_of({"topics": {"pose": "/robot/tf"}})
    outlet.wants(*with_tf)
    by_name = {topic.name: callback for topic, callback in capture.subscriptions.items()}
    mount = transform_to_msg(LINK_OPTICAL, 0, "base", "driver_frame")
    base = [transform_to_msg(LINK_OPTICAL.after(at(x)), round(t * S), "map", "base") for x, t in ((0, 0.9), (4, 1.1))]
    by_name["/robot/tf_static"](Transforms([mount]))
    capture.on_camera_info(info(S))
    capture.on_image(image(S))
    for one in base:
        by_name["/robot/tf"](Transforms([one]))
    (posed,) = outlet.on(POSED_POSE)
    expected = LINK_OPTICAL.after(LINK_OPTICAL.after(at(2.0)))
    np.testing.assert_allclose(msg_to_pose(posed).position, expected.position)
    np.testing.assert_allclose(msg_to_pose(posed).rotation, expected.rotation, atol=1e-12)
    assert health.dropped == {}
    (moved,), (fixed,) = (outlet.on(topic)[0].transforms for topic in with_tf)
    assert (moved.header.frame_id, moved.child_frame_id, fixed.header.frame_id) == ("map", "eye_link", "eye_link")
    through = msg_to_transform(fixed).after(msg_to_transform(moved))
    np.testing.assert_allclose(through.rotation, expected.rotation, atol=1e-12)
    np.testing.assert_allclose(through.position, expected.position)
