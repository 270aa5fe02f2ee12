from __future__ import annotations

from array import array

import numpy as np
import pytest
from numpy.typing import NDArray
from sensor_msgs.msg import PointField

from ltm_core.errors import MessageError
from ltm_msgs_py.points import msg_to_points, points_to_msg

RNG = np.random.default_rng(2)
XYZ = RNG.normal(scale=3000, size=(5, 3)).astype(np.float32)
RGB = np.array([[255, 0, 1], [0, 0, 0], [1, 2, 3], [127, 128, 255], [255, 255, 255]], np.uint8)
LABEL = np.array([0, 3, 255, 6, 1], np.uint8)


@pytest.mark.parametrize("rgb", [RGB, None])
@pytest.mark.parametrize("label", [LABEL, None])
def test_points_round_trip(rgb: NDArray[np.uint8] | None, label: NDArray[np.uint8] | None) -> None:
    msg = points_to_msg(XYZ, 6_000_000_007, "map", rgb, label)
    back = msg_to_points(msg)
    np.testing.assert_array_equal(back.xyz, XYZ)
    for given, found in ((rgb, back.rgb), (label, back.label)):
        assert (given is None) == (found is None)
        if given is not None:
            np.testing.assert_array_equal(found, given)
    assert (msg.header.stamp.sec, msg.header.stamp.nanosec, msg.header.frame_id) == (6, 7, "map")


def test_colour_is_packed_as_pcl_reads_it() -> None:
    """PCL: the bytes of the float32, little-endian, are b, g, r, 0."""
    msg = points_to_msg(XYZ, 0, "map", RGB)
    (field,) = (f for f in msg.fields if f.name == "rgb")
    assert field.datatype == PointField.FLOAT32
    packed = np.frombuffer(msg.data, np.uint8).reshape(5, msg.point_step)[:, field.offset : field.offset + 4]
    np.testing.assert_array_equal(packed, np.column_stack([RGB[:, ::-1], np.zeros(5, np.uint8)]))


def test_points_of_an_organised_padded_cloud_are_read_row_by_row() -> None:
    msg = points_to_msg(XYZ[:4], 0, "map")
    rows = np.frombuffer(msg.data, np.uint8).reshape(2, 24)
    msg.height, msg.width, msg.row_step = 2, 2, 30
    msg.data = array("B", np.hstack([rows, np.full((2, 6), 0xEE, np.uint8)]).tobytes())
    np.testing.assert_array_equal(msg_to_points(msg).xyz, XYZ[:4])


def test_other_fields_are_left_aside() -> None:
    msg = points_to_msg(XYZ, 0, "map", label=LABEL)
    msg.fields[3].name = "ring"
    points = msg_to_points(msg)
    assert points.label is None
    np.testing.assert_array_equal(points.xyz, XYZ)


def test_density_tells_of_nan() -> None:
    xyz = XYZ.copy()
    assert points_to_msg(xyz, 0, "map").is_dense
    xyz[2, 1] = np.nan
    assert not points_to_msg(xyz, 0, "map").is_dense


def test_no_points_are_points() -> None:
    assert msg_to_points(points_to_msg(np.empty((0, 3), np.float32), 0, "map")).xyz.shape == (0, 3)


@pytest.mark.parametrize(
    ("xyz", "rgb", "label", "complaint"),
    [
        (XYZ.astype(np.float64), None, None, r"\(N, 3\) float32"),
        (XYZ[:, :2], None, None, r"\(N, 3\) float32"),
        (XYZ, RGB[:4], None, r"\(5, 3\) uint8"),
        (XYZ, RGB.astype(np.float32), None, r"\(5, 3\) uint8"),
        (XYZ, None, LABEL[:4], r"\(5,\) uint8"),
        (XYZ, None, LABEL.astype(np.int32), r"\(5,\) uint8"),
    ],
)
def test_arrays_of_another_kind_are_refused(
    xyz: NDArray[np.float32], rgb: NDArray[np.uint8] | None, label: NDArray[np.uint8] | None, complaint: str
) -> None:
    with pytest.raises(MessageError, match=complaint):
        points_to_msg(xyz, 0, "map", rgb, label)


@pytest.mark.parametrize(("field", "datatype"), [(0, PointField.INT32), (3, PointField.INT32), (4, PointField.INT8)])
def test_fields_of_another_type_are_refused(field: int, datatype: int) -> None:
    msg = points_to_msg(XYZ, 0, "map", RGB, LABEL)
    msg.fields[field].datatype = datatype
    with pytest.raises(MessageError, match=f"'{msg.fields[field].name}' is int"):
        msg_to_points(msg)
