from __future__ import annotations

from array import array
from collections.abc import Callable

import numpy as np
import pytest
from sensor_msgs.msg import PointCloud2, PointField

from ltm_core.errors import MessageError
from ltm_core.fuel.votes import CellVotes
from ltm_core.grid import GridGeometry
from ltm_msgs_py.votes import msg_to_votes, votes_to_msg

GRID = GridGeometry(-585.0, 315.0, 30.0, 7, 5)
NAMES = ("grass", "shrub", "tree")
VOTES = CellVotes(
    GRID,
    np.array([0, 1, 1, 4], np.int32),
    np.array([6, 0, 3, 2], np.int32),
    np.array([[1, 2, 3], [40, 50, 60], [0, 0, 4_000_000_000], [7, 8, 9]], np.uint32),
    np.array([751.5, 749.25, np.nan, 640.125], np.float32),
    8_000_000_123,
    "east",
)


def message() -> PointCloud2:
    return votes_to_msg(VOTES, NAMES)


def set_value(msg: PointCloud2, point: int, field: str, value: float) -> None:
    """Write into the packed points, by the layout that the message itself states."""
    (entry,) = (f for f in msg.fields if f.name == field)
    dtype = {PointField.FLOAT32: np.float32, PointField.INT32: np.int32, PointField.UINT32: np.uint32}[entry.datatype]
    at = point * msg.point_step + entry.offset
    msg.data[at : at + 4] = array("B", np.array([value], dtype).tobytes())


def test_fields_are_those_of_the_contract() -> None:
    msg = message()
    kinds = {f.name: (f.datatype, f.count) for f in msg.fields}
    assert kinds == {
        **dict.fromkeys("xyz", (PointField.FLOAT32, 1)),
        **dict.fromkeys(("row", "col"), (PointField.INT32, 1)),
        **dict.fromkeys(NAMES, (PointField.UINT32, 1)),
    }
    assert (msg.height, msg.width, msg.point_step, msg.row_step) == (1, 4, 32, 128)
    assert (msg.header.stamp.sec, msg.header.stamp.nanosec, msg.header.frame_id) == (8, 123, "map")
    assert not msg.is_dense  # a height is NaN


def test_votes_round_trip() -> None:
    back = msg_to_votes(message(), GRID, NAMES, "east")
    np.testing.assert_array_equal(back.rows, VOTES.rows)
    np.testing.assert_array_equal(back.cols, VOTES.cols)
    np.testing.assert_array_equal(back.counts, VOTES.counts)
    np.testing.assert_array_equal(back.z, VOTES.z)
    assert back.counts.dtype == np.uint32
    assert (back.geometry, back.stamp_ns, back.source) == (GRID, VOTES.stamp_ns, "east")


def test_points_stand_on_their_cells() -> None:
    msg = message()
    xyz = np.frombuffer(msg.data, np.float32).reshape(4, -1)[:, :3]
    np.testing.assert_array_equal(xyz[:, 0], [-390, -570, -480, -510])
    np.testing.assert_array_equal(xyz[:, 1], [300, 270, 270, 180])


def test_no_votes_at_all_are_votes() -> None:
    empty = CellVotes(
        GRID, np.empty(0, np.int32), np.empty(0, np.int32), np.empty((0, 3), np.uint32), np.empty(0, np.float32), 5, "e"
    )
    back = msg_to_votes(votes_to_msg(empty, NAMES), GRID, NAMES, "e")
    assert back.counts.shape == (0, 3)


def test_classes_are_found_by_name_whatever_their_order() -> None:
    back = msg_to_votes(message(), GRID, ("tree", "grass", "shrub"), "east")
    np.testing.assert_array_equal(back.counts, VOTES.counts[:, [2, 0, 1]])


def test_big_endian_votes_come_out_native() -> None:
    msg = message()
    msg.data = array("B", np.frombuffer(msg.data, np.uint32).byteswap().tobytes())
    msg.is_bigendian = True
    np.testing.assert_array_equal(msg_to_votes(msg, GRID, NAMES, "east").counts, VOTES.counts)


@pytest.mark.parametrize("names", [("grass", "shrub"), ("grass", "shrub", "tree", "bare")])
def test_names_that_are_not_as_many_as_classes_cannot_be_written(names: tuple[str, ...]) -> None:
    with pytest.raises(MessageError, match="count 3 classes"):
        votes_to_msg(VOTES, names)


@pytest.mark.parametrize("names", [(), ("x", "a", "b"), ("row", "a", "b"), ("a", "a", "b"), ("a b", "c", "d")])
def test_names_that_make_no_fields_are_refused(names: tuple[str, ...]) -> None:
    with pytest.raises(MessageError, match="distinct identifiers"):
        votes_to_msg(VOTES, names)


def _set(name: str, value: int) -> Callable[[PointCloud2], None]:
    return lambda msg: setattr(msg, name, value)


def _field(index: int, name: str, value: int | str) -> Callable[[PointCloud2], None]:
    return lambda msg: setattr(msg.fields[index], name, value)


def _swap_first_two(msg: PointCloud2) -> None:
    step = msg.point_step
    msg.data = msg.data[step : 2 * step] + msg.data[:step] + msg.data[2 * step :]


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (_set("point_step", 31), "'tree' at offset 28 leaves its point of 31"),
        (_set("point_step", 0), "point_step 0"),
        (_set("point_step", 33), "row_step must be at least width"),
        (_set("point_step", 2**32 - 1), "holds 128 bytes"),
        (_set("row_step", 127), "holds 128 bytes"),
        (_set("width", 5), "holds 128 bytes"),
        (_set("width", -4), "width -4"),
        (_set("height", 2), "holds 128 bytes"),
        (_set("height", -1), "height -1"),
        (lambda m: m.data.pop(), "holds 127 bytes"),
        (lambda m: m.fields.clear(), "no fields"),
        (lambda m: m.fields.pop(3), "lacks the field 'row'"),
        (lambda m: m.fields.pop(6), "lacks the field 'shrub'"),
        (_field(6, "name", "cactus"), "fields cactus"),
        (_field(6, "name", "grass"), "'grass' twice"),
        (_field(6, "datatype", PointField.FLOAT32), "'shrub' is float32, must be uint32"),
        (_field(3, "datatype", PointField.UINT32), "'row' is uint32, must be int32"),
        (_field(0, "datatype", PointField.FLOAT64), "'x' is float64"),
        (_field(0, "datatype", 0), "datatype 0"),
        (_field(0, "datatype", 9), "datatype 9"),
        (_field(0, "count", 2), "count 2"),
        (_field(0, "offset", 2**32 - 4), "leaves its point"),
        (lambda m: set_value(m, 2, "row", -1), r"\(-1, 3\), outside"),
        (lambda m: set_value(m, 2, "row", 5), r"\(5, 3\), outside a fuel grid of \(5, 7\)"),
        (lambda m: set_value(m, 2, "col", 7), r"\(1, 7\), outside"),
        (lambda m: set_value(m, 2, "col", 0), r"point 2 is cell \(1, 0\), which comes twice"),
        (_swap_first_two, "out of row-major order"),
        (lambda m: set_value(m, 1, "x", -540.0), "different fuel grids"),
        (lambda m: set_value(m, 1, "y", float("nan")), "different fuel grids"),
        (lambda m: setattr(m.header.stamp, "sec", -1), "sec=-1"),
    ],
)
def test_hostile_votes_are_refused(change: Callable[[PointCloud2], object], complaint: str) -> None:
    msg = message()
    change(msg)
    with pytest.raises(MessageError, match=complaint):
        msg_to_votes(msg, GRID, NAMES, "east")


def test_votes_counted_on_a_grid_moved_by_a_cell_are_refused() -> None:
    with pytest.raises(MessageError, match="sender and receiver use different fuel grids"):
        msg_to_votes(message(), GRID.translated(30.0, 0.0), NAMES, "east")
