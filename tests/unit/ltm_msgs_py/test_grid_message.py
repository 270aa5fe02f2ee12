from array import array
from collections.abc import Callable

import numpy as np
import pytest
from nav_msgs.msg import OccupancyGrid

from ltm_core.base.errors import MessageError
from ltm_core.geometry.grid import GridGeometry
from ltm_msgs_py.grid import classes_to_msg, msg_to_classes, tile_to_msg, tile_window

GRID = GridGeometry(-585.0, 315.0, 30.0, 4, 3)
CLASSES = np.array([[0, 1, 2, 3], [255, 4, 5, 6], [7, 127, 255, 9]], np.uint8)


def test_rows_run_from_the_south_and_unknown_is_minus_one() -> None:
    msg = classes_to_msg(CLASSES, GRID, 4_000_000_005)
    assert list(msg.data) == [7, 127, -1, 9, -1, 4, 5, 6, 0, 1, 2, 3]
    assert (msg.info.width, msg.info.height, msg.info.resolution) == (4, 3, 30.0)
    assert (msg.info.origin.position.x, msg.info.origin.position.y) == (-585.0, 225.0)
    assert (msg.info.origin.orientation.w, msg.header.frame_id) == (1.0, "map")
    assert (msg.header.stamp.sec, msg.info.map_load_time.nanosec) == (4, 5)


def test_a_tile_is_a_window_and_finds_its_place() -> None:
    msg = tile_to_msg(CLASSES, GRID, (1, 2, 2, 2), 0)
    classes, geometry = msg_to_classes(msg)
    np.testing.assert_array_equal(classes, CLASSES[1:3, 2:4])
    assert tile_window(geometry, GRID) == (1, 2, 2, 2)


@pytest.mark.parametrize("window", [(-1, 0, 1, 1), (0, 3, 1, 2), (2, 0, 2, 1), (0, 0, 0, 1), (0, 0, 1, -1)])
def test_a_tile_that_leaves_the_grid_is_refused(window: tuple[int, int, int, int]) -> None:
    with pytest.raises(MessageError, match="is outside the grid of 3 x 4"):
        tile_to_msg(CLASSES, GRID, window, 0)


@pytest.mark.parametrize(
    ("tile", "complaint"),
    [
        (GridGeometry(-580.0, 315.0, 30.0, 1, 1), "is not aligned"),
        (GridGeometry(-585.0, 300.0, 30.0, 1, 1), "is not aligned"),
        (GridGeometry(-585.0, 315.0, 10.0, 1, 1), "is not aligned"),
        (GridGeometry(-615.0, 315.0, 30.0, 1, 1), "is outside the grid"),
        (GridGeometry(-585.0, 345.0, 30.0, 1, 1), "is outside the grid"),
        (GridGeometry(-585.0, 315.0, 30.0, 5, 1), "is outside the grid"),
        (GridGeometry(-585.0, 315.0, 30.0, 1, 4), "is outside the grid"),
    ],
)
def test_a_tile_of_another_grid_is_refused(tile: GridGeometry, complaint: str) -> None:
    with pytest.raises(MessageError, match=complaint):
        tile_window(tile, GRID)


def test_class_codes_that_int8_cannot_hold_are_refused_with_their_cell() -> None:
    classes = CLASSES.copy()
    classes[2, 1] = 204
    with pytest.raises(MessageError, match="class 204 at row 2, col 1"):
        classes_to_msg(classes, GRID, 0)


def _data(values: list[int]) -> Callable[[OccupancyGrid], None]:
    return lambda msg: setattr(msg, "data", array("b", values))


def _size(width: int, height: int) -> Callable[[OccupancyGrid], None]:
    def change(msg: OccupancyGrid) -> None:
        msg.info.width, msg.info.height = width, height

    return change


def _turned(msg: OccupancyGrid) -> None:
    msg.info.origin.orientation.z = msg.info.origin.orientation.w = 0.70710678


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (_data([0] * 11), "holds 11 values"),
        (_data([0] * 13), "holds 13 values"),
        (_data([0] * 5 + [-2] + [0] * 6), "-2 at data row 1, col 1"),
        (_size(0, 0), "0 x 0"),
        (_size(-4, -3), "-4 x -3"),
        (lambda m: setattr(m.info, "resolution", 0.0), "positive resolution"),
        (lambda m: setattr(m.info, "resolution", float("nan")), "positive resolution"),
        (lambda m: setattr(m.info.origin.position, "x", float("inf")), "finite origin"),
        (_turned, "rotated"),
        (lambda m: setattr(m.info.origin.orientation, "w", 0.0), "rotated"),
        (lambda m: setattr(m.info.origin.orientation, "x", float("nan")), "rotated"),
    ],
)
def test_grids_that_contradict_themselves_are_refused(change: Callable[[OccupancyGrid], None], complaint: str) -> None:
    msg = classes_to_msg(CLASSES, GRID, 0)
    change(msg)
    with pytest.raises(MessageError, match=complaint):
        msg_to_classes(msg)
