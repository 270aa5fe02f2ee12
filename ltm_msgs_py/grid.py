"""Convert north-up class grids to nav_msgs/OccupancyGrid, and back.

OccupancyGrid counts rows from the south, its origin is the outer corner of the south-west cell, and its cells are int8
with -1 as unknown. Ours count from the north and are uint8 with 255 as unknown. This is the one place with the flip."""

from array import array as int8_array
from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid

from ltm_core.base.errors import MessageError
from ltm_core.base.types import UInt8Array
from ltm_core.geometry.grid import GridGeometry
from ltm_msgs_py.stamp import make_header, ns_to_time

UNKNOWN = 255
LARGEST_CLASS = 127


def classes_to_msg(classes: UInt8Array, geometry: GridGeometry, stamp_ns: int) -> OccupancyGrid:
    """Return a grid of class indices, (H, W) uint8 north up with 255 unknown, as an OccupancyGrid with -1 unknown.

    Class indices 0..127 fit int8; fuel model numbers do not. Raises MessageError for those and wrong shapes."""
    if classes.shape != geometry.shape or classes.dtype != np.uint8:
        raise MessageError(f"class grid is {classes.shape} {classes.dtype}, its geometry says {geometry.shape} uint8")
    too_large = (classes > LARGEST_CLASS) & (classes != UNKNOWN)
    if too_large.any():
        row, col = np.argwhere(too_large)[0]
        what = f"class {classes[row, col]} at row {row}, col {col} does not fit OccupancyGrid's int8"
        raise MessageError(f"{what}: send class indices 0..{LARGEST_CLASS}, {UNKNOWN} for unknown")
    msg = OccupancyGrid(header=make_header(stamp_ns, "map"))
    msg.info.map_load_time = ns_to_time(stamp_ns)
    msg.info.resolution = float(geometry.resolution)
    msg.info.height, msg.info.width = geometry.shape
    msg.info.origin.position.x = float(geometry.x_min)
    msg.info.origin.position.y = float(geometry.y_min)
    msg.info.origin.orientation.w = 1.0
    data = int8_array("b")
    # As int8 bits, 255 is -1: the flip is the whole conversion.
    data.frombytes(np.ascontiguousarray(np.flipud(classes)).data.cast("B"))
    msg.data = data
    return msg


def tile_to_msg(
    classes: UInt8Array, geometry: GridGeometry, window: tuple[int, int, int, int], stamp_ns: int
) -> OccupancyGrid:
    """Return the part `window` = (row, col, height, width) of a class grid as its own OccupancyGrid.

    Raises MessageError if the window exceeds the grid, and as `classes_to_msg`."""
    row, col, height, width = _inside(window, geometry)
    part = classes[row : row + height, col : col + width]
    return classes_to_msg(part, geometry.window(row, col, height, width), stamp_ns)


def msg_to_classes(msg: Any, crs: str | None = None) -> tuple[UInt8Array, GridGeometry]:
    """Return the class grid, (H, W) uint8 north up with 255 unknown, and the geometry of an OccupancyGrid.

    Raises MessageError for another length than width * height, a cell below -1, and an empty, rotated or infinite
    grid."""
    info = msg.info
    height, width = int(info.height), int(info.width)
    if height < 1 or width < 1 or len(msg.data) != height * width:
        raise MessageError(f"OccupancyGrid of {width} x {height} cells holds {len(msg.data)} values; expected as many")
    # info.resolution is float32 on the wire: take the shortest decimal that it stands for, so 0.1 comes back as 0.1.
    resolution = float(str(np.float32(info.resolution)))
    x_min, y_min = float(info.origin.position.x), float(info.origin.position.y)
    if not np.isfinite([resolution, x_min, y_min]).all() or resolution <= 0:
        given = f"{info.resolution}, ({x_min}, {y_min})"
        raise MessageError(f"OccupancyGrid needs a positive resolution and a finite origin, got {given}")
    q = info.origin.orientation
    turned = max(abs(q.x), abs(q.y), abs(q.z))
    if not (turned <= 1e-6 and abs(abs(q.w) - 1) <= 1e-3):
        raise MessageError(f"OccupancyGrid's origin is rotated by {q.x, q.y, q.z, q.w}; expected (0, 0, 0, 1)")
    cells = np.frombuffer(msg.data, np.int8).reshape(height, width)
    if cells.min() < -1:
        south_row, col = np.argwhere(cells < -1)[0]
        cell = f"{cells[south_row, col]} at data row {south_row}, col {col}"
        raise MessageError(f"OccupancyGrid cell {cell} is below -1 (unknown)")
    classes = np.flipud(cells).astype(np.uint8)
    return classes, GridGeometry(x_min, y_min + height * resolution, resolution, width, height, crs)


def tile_window(tile: GridGeometry, grid: GridGeometry) -> tuple[int, int, int, int]:
    """Return the place of a tile in a grid: (row, col, height, width).

    Raises MessageError if its cells have another size, are not aligned with the grid's, or exceed it."""
    corner = (grid.y_max - tile.y_max) / grid.resolution, (tile.x_min - grid.x_min) / grid.resolution
    off = max(abs(place - round(place)) for place in corner)
    if abs(tile.resolution - grid.resolution) > 1e-6 * grid.resolution or off > 1e-3:
        of_tile = f"({tile.x_min}, {tile.y_max}) and cells of {tile.resolution} m"
        of_grid = f"({grid.x_min}, {grid.y_max}) and cells of {grid.resolution} m"
        raise MessageError(f"tile with corner {of_tile} is not aligned with the grid with corner {of_grid}")
    return _inside((round(corner[0]), round(corner[1]), tile.height, tile.width), grid)


def _inside(window: tuple[int, int, int, int], grid: GridGeometry) -> tuple[int, int, int, int]:
    row, col, height, width = window
    if min(row, col) < 0 or min(height, width) < 1 or row + height > grid.height or col + width > grid.width:
        cells = f"{grid.height} x {grid.width} cells"
        raise MessageError(f"tile row, col, height, width = {window} is outside the grid of {cells}")
    return window
