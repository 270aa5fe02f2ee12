"""Whatever a core type holds, its message gives it back; any message is read or refused, and nothing else."""

from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rclpy.serialization import deserialize_message, serialize_message

from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_msgs_py.grid import classes_to_msg, msg_to_classes, tile_window
from ltm_msgs_py.image import ENCODINGS, image_to_msg, msg_to_array
from ltm_msgs_py.pointcloud import msg_to_votes, votes_to_msg
from ltm_msgs_py.pose import msg_to_pose, pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg, msg_to_camera
from ltm_msgs_py.stamp import LATEST_NS, ns_to_time, time_to_ns

quick = settings(max_examples=60, deadline=None)

stamps = st.integers(0, LATEST_NS)
finite = st.floats(-1e6, 1e6)


def on_the_wire(msg: Any) -> Any:
    """The message as another process receives it: float32 fields rounded, arrays of their own."""
    return deserialize_message(serialize_message(msg), type(msg))


@quick
@given(stamps)
def test_stamps(stamp_ns: int) -> None:
    assert time_to_ns(on_the_wire(ns_to_time(stamp_ns))) == stamp_ns


@quick
@given(st.data(), st.sampled_from(sorted(ENCODINGS)), st.integers(1, 9), st.integers(1, 9), stamps)
def test_images(data: st.DataObject, encoding: str, height: int, width: int, stamp_ns: int) -> None:
    spec = ENCODINGS[encoding]
    shape = (height, width) if spec.channels == 1 else (height, width, spec.channels)
    image = data.draw(arrays(spec.dtype, shape))
    back = msg_to_array(on_the_wire(image_to_msg(image, encoding, stamp_ns, "c")))
    assert back.tobytes() == image.tobytes()


sides, focals, bends = st.integers(1, 9000), st.floats(1e-3, 1e6), st.tuples(*[st.floats(-2, 2)] * 5)


@quick
@given(st.builds(Camera, sides, sides, focals, focals, finite, finite, bends), stamps)
def test_cameras(camera: Camera, stamp_ns: int) -> None:
    assert msg_to_camera(on_the_wire(camera_to_msg(camera, stamp_ns, "c"))) == camera


@quick
@given(st.tuples(finite, finite, finite), st.floats(0, 360), st.floats(-90, 90), st.floats(-180, 180), stamps)
def test_poses(position: tuple[float, float, float], azimuth: float, pitch: float, roll: float, stamp_ns: int) -> None:
    pose = Pose.from_angles(position, azimuth, pitch, roll)
    back = msg_to_pose(on_the_wire(pose_to_msg(pose, stamp_ns)))
    np.testing.assert_array_equal(back.position, pose.position)
    np.testing.assert_allclose(back.rotation, pose.rotation, atol=4e-15)


@quick
@given(
    st.data(), st.integers(1, 8), st.integers(1, 8), st.integers(-(10**6), 10**6), st.integers(-(10**6), 10**6), stamps
)
def test_class_grids(data: st.DataObject, height: int, width: int, x: int, y: int, stamp_ns: int) -> None:
    allowed = st.one_of(st.integers(0, 127), st.just(255))
    classes = data.draw(arrays(np.uint8, (height, width), elements=allowed))
    resolution = data.draw(st.sampled_from([30.0, 10.0, 1.0, 0.5, 0.1]))
    geometry = GridGeometry(x / 2, y / 2, resolution, width, height)
    back, found = msg_to_classes(on_the_wire(classes_to_msg(classes, geometry, stamp_ns)))
    np.testing.assert_array_equal(back, classes)
    assert tile_window(found, geometry) == (0, 0, height, width)
    assert found.resolution == resolution


@quick
@given(st.data(), st.integers(1, 7), st.integers(1, 9), st.integers(1, 5), stamps)
def test_votes(data: st.DataObject, height: int, width: int, classes: int, stamp_ns: int) -> None:
    geometry = GridGeometry(-4515.0, 8025.0, 30.0, width, height)
    cells = np.array(sorted(data.draw(st.sets(st.integers(0, height * width - 1)))), np.int32)
    n = len(cells)
    votes = CellVotes(
        geometry,
        cells // width,
        cells % width,
        data.draw(arrays(np.uint32, (n, classes), elements=st.integers(0, 65_535))),
        data.draw(arrays(np.float32, n)),
        stamp_ns,
        "east",
    )
    names = tuple(f"class_{k}" for k in range(classes))
    back = msg_to_votes(on_the_wire(votes_to_msg(votes, names)), geometry, names, "east")
    for name in ("rows", "cols", "counts", "z"):
        sent, found = getattr(votes, name), getattr(back, name)
        assert (found.dtype, found.tobytes()) == (sent.dtype, sent.tobytes())
    assert back.stamp_ns == stamp_ns
