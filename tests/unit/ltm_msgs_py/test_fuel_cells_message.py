from __future__ import annotations

from array import array
from dataclasses import replace

import numpy as np
import pytest

from ltm_core.base.errors import MessageError
from ltm_core.fuel.codes import FuelClimate
from ltm_core.fuel.decision import FuelLayers, layers_of_classes
from ltm_core.geometry.grid import GridGeometry
from ltm_msgs_py.cells import fuel_cells_to_msg, msg_to_fuel_cells
from ltm_msgs_py.stamp import stamp_of

GRID = GridGeometry(-60.0, 300.0, 30.0, 7, 5)
HEIGHTS = 400.0 + np.arange(35.0).reshape(5, 7)


def layers() -> FuelLayers:
    rng = np.random.default_rng(4)
    classes = rng.integers(1, 8, GRID.shape).astype(np.uint8)
    seen = rng.random(GRID.shape) < 0.5
    plain = layers_of_classes(classes, None, FuelClimate.named("dry"))
    return replace(
        plain,
        last_seen=np.where(seen, 10**18, 0),
        seen_by=np.where(seen, 3, 0).astype(np.uint8),
        prior=np.where(~seen & (classes == 3), 99, plain.code).astype(np.int16),
        entropy=rng.random(GRID.shape).astype(np.float32),
    )


def test_touched_cells_come_back() -> None:
    sent = layers()
    message = fuel_cells_to_msg(sent, HEIGHTS, GRID, 12_000_000_345)
    assert stamp_of(message) == 12_000_000_345
    cells = msg_to_fuel_cells(message, GRID)
    touched = (sent.last_seen > 0) | sent.changed
    assert 5 < len(cells.rows) == touched.sum() < 30
    for name in cells.layers:
        whole = cells.raster(name, GRID.shape, 9)
        np.testing.assert_array_equal(whole[touched], getattr(sent, name)[touched])
        assert (whole[~touched] == 9).all()


def test_points_elsewhere_are_refused() -> None:
    def message() -> object:
        return fuel_cells_to_msg(layers(), HEIGHTS, GRID, 0)

    outside, nowhere, many, lacking = message(), message(), message(), message()
    outside.data[0:4] = array("B", np.float32(1e5).tobytes())
    nowhere.data[4:8] = array("B", np.float32("nan").tobytes())
    many.width = 36
    lacking.fields[3].name = "cover"
    for bad, complaint in (
        (outside, "outside the fuel grid"), (nowhere, "no finite position"), (many, "36 points"), (lacking, "life_form")
    ):  # fmt: skip
        with pytest.raises(MessageError, match=complaint):
            msg_to_fuel_cells(bad, GRID)
