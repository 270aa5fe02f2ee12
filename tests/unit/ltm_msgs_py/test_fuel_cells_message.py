from dataclasses import replace

import numpy as np

from ltm_core.fuel.codes import FuelClimate
from ltm_core.fuel.decision import FuelLayers, layers_of_classes
from ltm_core.geometry.grid import GridGeometry
from ltm_msgs_py.cells import fuel_cells_to_msg
from ltm_msgs_py.pointcloud import msg_to_columns
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
    cells = msg_to_columns(message)
    touched = (sent.last_seen > 0) | sent.changed
    assert 5 < len(cells["x"]) == touched.sum() < 30
    x, y = GRID.to_map(*np.nonzero(touched))
    np.testing.assert_allclose(cells["x"], x)
    np.testing.assert_allclose(cells["y"], y)
    np.testing.assert_allclose(cells["z"], HEIGHTS[touched])
    for name in cells.keys() - {"x", "y", "z"}:
        np.testing.assert_array_equal(cells[name], getattr(sent, name)[touched])
