from array import array
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2, PointField

from ltm_core.base.errors import MessageError
from ltm_core.fuel.vote_columns import MAX_BYTES, fitting
from ltm_core.fuel.votes import CellVisibility, CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_msgs_py.pointcloud import msg_to_votes, votes_to_msg

GRID = GridGeometry(-585.0, 315.0, 30.0, 7, 5)
NAMES = ("grass", "shrub", "tree")
VOTES = CellVotes(
    GRID,
    np.array([0, 1, 1, 4], np.int32),
    np.array([6, 0, 3, 2], np.int32),
    np.array([[1, 2, 3], [40, 50, 60], [0, 0, 65_535], [7, 8, 9]], np.uint32),
    np.array([751.5, 749.25, np.nan, 640.125], np.float32),
    8_000_000_123,
    "east",
    np.array([1.0, 0.0, 0.5, 0.2], np.float32),
    CellVisibility(
        *(
            np.array(column, np.float32)
            for column in (
                [1.0, 0.0, 0.4, 0.6],
                [0.0, 31.26, 6553.5, 1e6],
                [1.04, 22.2, 0.3, np.inf],
                [0.1, 3.3, 9.9, np.nan],
                [-3.1, 0.0, 1.5, 3.1],
            )
        )
    ),
)


def message() -> PointCloud2:
    return votes_to_msg(VOTES, NAMES)


def set_value(msg: PointCloud2, point: int, field: str, value: float) -> None:
    """Write into the packed points, by the layout that the message itself states."""
    (entry,) = (f for f in msg.fields if f.name == field)
    data = np.array([value], {PointField.FLOAT32: np.float32, PointField.UINT16: np.uint16}[entry.datatype]).tobytes()
    at = point * msg.point_step + entry.offset
    msg.data[at : at + len(data)] = array("B", data)


def test_fields_are_those_of_the_contract() -> None:
    msg = message()
    kinds = {f.name: (f.datatype, f.count) for f in msg.fields}
    assert kinds == {
        **dict.fromkeys("xyz", (PointField.FLOAT32, 1)),
        **dict.fromkeys(NAMES, (PointField.UINT16, 1)),
        **dict.fromkeys(("confidence", "cos_incidence"), (PointField.UINT8, 1)),
        **dict.fromkeys(("footprint_dm", "sigma_along_dm", "sigma_across_dm", "bearing_deg"), (PointField.UINT16, 1)),
    }
    assert (msg.height, msg.width, msg.point_step, msg.row_step) == (1, 4, 28, 112)
    assert (msg.header.stamp.sec, msg.header.stamp.nanosec, msg.header.frame_id) == (8, 123, "map")
    assert not msg.is_dense  # a height is NaN


def test_how_well_cells_are_seen_survives_to_the_wire_s_precision() -> None:
    back = msg_to_votes(message(), GRID, NAMES, "east")
    np.testing.assert_allclose(back.confidence, [1.0, 0.0, 0.5, 0.2], atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(back.visibility.cos_incidence, [1.0, 0.0, 0.4, 0.6], atol=0.5 / 255 + 1e-6)
    # What the field does not hold, and what is not known, is the worst that it holds.
    np.testing.assert_allclose(back.visibility.footprint, [0.0, 31.3, 6553.5, 6553.5], rtol=1e-6)
    np.testing.assert_allclose(back.visibility.sigma_along, [1.0, 22.2, 0.3, 6553.5], rtol=1e-6)
    np.testing.assert_allclose(back.visibility.sigma_across, [0.1, 3.3, 9.9, 6553.5], rtol=1e-6)
    np.testing.assert_allclose(np.degrees(back.visibility.bearing), [182, 0, 86, 178], atol=1e-4)
    assert {column.dtype for column in (back.confidence, *back.visibility.columns())} == {np.dtype(np.float32)}


def test_what_is_not_known_is_not_sent() -> None:
    plain = replace(VOTES, confidence=None, visibility=None)
    msg = votes_to_msg(plain, NAMES)
    assert [f.name for f in msg.fields] == ["x", "y", "z", *NAMES]
    back = msg_to_votes(msg, GRID, NAMES, "east")
    assert (back.confidence, back.visibility) == (None, None)


def test_classes_without_a_pixel_are_not_sent() -> None:
    counts = VOTES.counts.copy()
    counts[:, 1] = 0
    msg = votes_to_msg(replace(VOTES, counts=counts), NAMES)
    assert "shrub" not in [f.name for f in msg.fields]
    np.testing.assert_array_equal(msg_to_votes(msg, GRID, NAMES, "east").counts, counts)


def test_more_pixels_than_a_field_holds_keep_their_shares() -> None:
    counts = VOTES.counts.copy()
    counts[1] = (2_000_000, 500_000, 3)
    back = msg_to_votes(votes_to_msg(replace(VOTES, counts=counts), NAMES), GRID, NAMES, "east")
    assert back.counts[1].tolist() == [65_535, 16_384, 0]
    np.testing.assert_array_equal(back.counts[[0, 2, 3]], counts[[0, 2, 3]])


def far_view(cells: int) -> CellVotes:
    """A frame that sees so many cells, the later ones the worse."""
    grid = GridGeometry(-60.0, 90.0, 30.0, 120, 90)
    rows, cols = (index.astype(np.int32) for index in np.divmod(np.arange(cells), grid.width))
    counts = np.full((cells, 3), (5, 2, 1), np.uint32)
    length = np.linspace(1, 500, cells).astype(np.float32)
    visibility = CellVisibility(np.ones(cells, np.float32), length, length, length, length)
    return CellVotes(grid, rows, cols, counts, length, 1, "east", np.ones(cells, np.float32), visibility)


def test_message_of_a_wide_view_keeps_its_bound_and_leaves_no_cell_out_for_good() -> None:
    votes = far_view(9000)
    seen: Counter[int] = Counter()
    for stamp in range(150):
        part = fitting(replace(votes, stamp_ns=stamp))
        assert 0.9 * MAX_BYTES < len(serialize_message(votes_to_msg(part, NAMES))) <= MAX_BYTES
        cells = part.rows.astype(int) * 120 + part.cols
        assert (np.diff(cells) > 0).all()
        seen.update(cells.tolist())
    assert seen.keys() == set(range(9000))
    assert all(seen[cell] == 150 for cell in range(1500)), "what is seen best is in every message"
    assert fitting(far_view(1500)).rows.size == 1500


def test_points_stand_on_their_cells() -> None:
    msg = message()
    xyz = np.frombuffer(msg.data, np.uint8).reshape(4, -1)[:, :12].copy().view(np.float32)
    np.testing.assert_array_equal(xyz[:, 0], [-390, -570, -480, -510])
    np.testing.assert_array_equal(xyz[:, 1], [300, 270, 270, 180])


def test_classes_are_found_by_name_whatever_their_order() -> None:
    back = msg_to_votes(message(), GRID, ("tree", "grass", "shrub"), "east")
    np.testing.assert_array_equal(back.counts, VOTES.counts[:, [2, 0, 1]])


def test_big_endian_votes_come_out_native() -> None:
    msg = message()
    formats = {PointField.FLOAT32: "f4", PointField.UINT16: "u2", PointField.UINT8: "u1"}
    little = np.frombuffer(msg.data, [(f.name, "<" + formats[f.datatype]) for f in msg.fields])
    msg.data = array("B", little.astype([(f.name, ">" + formats[f.datatype]) for f in msg.fields]).tobytes())
    msg.is_bigendian = True
    np.testing.assert_array_equal(msg_to_votes(msg, GRID, NAMES, "east").counts, VOTES.counts)


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
        (_set("point_step", 27), "'bearing_deg' at offset 26 exceeds its point of 27"),
        (_set("point_step", 2**32 - 1), "holds 112 bytes"),
        (_set("width", 5), "holds 112 bytes"),
        (_set("width", -4), "width -4"),
        (_set("height", -1), "height -1"),
        (_set("width", 2**32 - 1), "state 4294967295 cells in 112 bytes; the fuel grid has 35"),
        (lambda m: setattr(m, "data", array("B", bytes(10_000_000))), "in 10000000 bytes; the fuel grid has 35"),
        (lambda m: m.data.pop(), "holds 111 bytes"),
        (lambda m: m.fields.clear(), "no fields"),
        (lambda m: m.fields.pop(1), "lacks the field 'y'"),
        (_field(4, "name", "cactus"), "fields cactus"),
        (_field(4, "name", "grass"), "duplicate field 'grass'"),
        (_field(4, "datatype", PointField.INT16), "'shrub' is int16, must be uint16"),
        (_field(6, "datatype", PointField.INT8), "'confidence' is int8, must be uint8"),
        (lambda m: m.fields.pop(7), "lacks the field 'cos_incidence'"),
        (_field(0, "datatype", 0), "datatype 0"),
        (_field(0, "count", 2), "count 2"),
        (_field(0, "offset", 2**32 - 4), "exceeds its point"),
        (lambda m: set_value(m, 2, "y", 330.0), r"point 2 at \(-480.0, 330.0\) is outside a fuel grid of \(5, 7\)"),
        (lambda m: set_value(m, 2, "x", float("nan")), "outside a fuel grid"),
        (lambda m: set_value(m, 2, "x", -570.0), "point 2 at .* is duplicated"),
        (_swap_first_two, "not in row-major order"),
        (lambda m: set_value(m, 1, "x", -555.0), "different fuel grids"),
        (lambda m: setattr(m.header.stamp, "sec", -1), "sec=-1"),
    ],
)
def test_hostile_votes_are_refused(change: Callable[[PointCloud2], object], complaint: str) -> None:
    msg = message()
    change(msg)
    with pytest.raises(MessageError, match=complaint):
        msg_to_votes(msg, GRID, NAMES, "east")


def test_votes_count_where_they_stand() -> None:
    """Points say where they are on the map: a sender whose grid begins a column further west means the same cells."""
    wider = GridGeometry(GRID.x_min - 30.0, GRID.y_max, 30.0, 8, 5)
    moved = replace(VOTES, geometry=wider, cols=VOTES.cols + np.int32(1))
    np.testing.assert_array_equal(msg_to_votes(votes_to_msg(moved, NAMES), GRID, NAMES, "east").cols, VOTES.cols)
