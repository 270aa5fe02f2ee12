import math
from dataclasses import replace

import numpy as np
import pytest
from pyproj import Transformer
from scenes.fuel_frames import votes

from ltm_core.base.errors import MessageError
from ltm_core.fuel.class_map import snapped_grid
from ltm_core.geometry.grid import GridGeometry
from ltm_core.uplink.vote_transfer import VoteTransfer

TOWER = GridGeometry(480_015.0, 4_150_905.0, 30.0, 90, 70, "EPSG:26911")
ORIGIN = (480_000.0, 4_148_000.0)


def in_map(grid: GridGeometry, origin: tuple[float, float]) -> GridGeometry:
    return grid.translated(-origin[0], -origin[1])


def transfer(target: GridGeometry, origin: tuple[float, float]) -> VoteTransfer:
    return VoteTransfer(TOWER, target, in_map(target, origin))


def test_cells_that_coincide_are_taken_exactly() -> None:
    region, origin = GridGeometry(478_995.0, 4_152_015.0, 30.0, 200, 150, "EPSG:26911"), (478_000.0, 4_140_000.0)
    sent = votes(3, in_map(TOWER, ORIGIN))
    got = transfer(region, origin).votes(sent)
    assert got.geometry == in_map(region, origin)
    np.testing.assert_array_equal(got.rows, sent.rows + 37)
    np.testing.assert_array_equal(got.cols, sent.cols + 34)
    np.testing.assert_array_equal(got.counts, sent.counts)
    assert got.visibility is not None
    assert sent.visibility is not None
    np.testing.assert_array_equal(got.visibility.bearing, sent.visibility.bearing)


def test_cells_beyond_the_region_are_left_out() -> None:
    region = GridGeometry(480_615.0, 4_150_305.0, 30.0, 40, 25, "EPSG:26911")
    sent = votes(3, in_map(TOWER, ORIGIN))
    got = transfer(region, ORIGIN).votes(sent)
    inside = (sent.rows >= 20) & (sent.rows < 45) & (sent.cols >= 20) & (sent.cols < 60)
    assert 0 < inside.sum() < len(sent)
    np.testing.assert_array_equal(got.rows, sent.rows[inside] - 20)
    np.testing.assert_array_equal(got.counts, sent.counts[inside])
    far = GridGeometry(600_015.0, 4_150_305.0, 30.0, 40, 25, "EPSG:26911")
    assert len(transfer(far, ORIGIN).votes(sent)) == 0


def test_in_another_crs_each_cell_takes_what_was_seen_at_its_centre() -> None:
    """Against a loop over the region's cells, with the next zone to the west, whose grid north is 2.4 degrees away."""
    region, origin = snapped_grid(TOWER, "EPSG:26910").window(3, 2, 80, 92), (1_008_000.0, 4_158_000.0)
    sent = votes(5, in_map(TOWER, ORIGIN))
    got = transfer(region, origin).votes(sent)
    to_tower = Transformer.from_crs("EPSG:26910", "EPSG:26911", always_xy=True)
    seen = {(int(row), int(col)): k for k, (row, col) in enumerate(zip(sent.rows, sent.cols, strict=True))}
    expected = []
    for row in range(region.height):
        centres = region.to_map(np.full(region.width, row), np.arange(region.width))
        for col, (x, y) in enumerate(zip(*to_tower.transform(*centres), strict=True)):
            cell = math.floor((TOWER.y_max - y) / 30), math.floor((x - TOWER.x_min) / 30)
            if cell in seen:
                expected.append((row, col, seen[cell]))
    rows, cols, source = np.array(expected).T
    assert 0.9 < len(expected) / len(sent) < 1.05
    np.testing.assert_array_equal(got.rows, rows)
    np.testing.assert_array_equal(got.cols, cols)
    np.testing.assert_array_equal(got.counts, sent.counts[source])
    assert got.visibility is not None
    assert sent.visibility is not None
    # A step along the bearing, in both grids, leads to the same place.
    x, y = TOWER.to_map(35, 45)
    turn = math.degrees(float(got.visibility.bearing[0] - sent.visibility.bearing[source[0]]))
    to_region = Transformer.from_crs("EPSG:26911", "EPSG:26910", always_xy=True)
    x0, y0 = to_region.transform(x, y)
    x1, y1 = to_region.transform(x, y + 1000.0)
    assert (turn + 180) % 360 - 180 == pytest.approx(math.degrees(math.atan2(x1 - x0, y1 - y0)), abs=0.02)
    assert abs((turn + 180) % 360 - 180) > 2


def test_other_cells_and_other_grids_are_refused() -> None:
    with pytest.raises(MessageError, match="30 m wide, the region's 10 m"):
        transfer(replace(TOWER, resolution=10.0), ORIGIN)
    huge = replace(TOWER, width=4000, height=4000)
    with pytest.raises(MessageError, match="the limit is"):
        VoteTransfer(huge, TOWER, in_map(TOWER, ORIGIN))
    with pytest.raises(MessageError, match="not on"):
        transfer(TOWER, ORIGIN).votes(votes(3, replace(in_map(TOWER, ORIGIN), width=91)))
