from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from scenes.outlets import Kept
from scenes.small_site import BEGIN_NS, NAME
from scenes.terrain_frames import HOUR, measured_messages, sunk, write_terrain_site

from ltm_core.raster.raster_io import write_geotiff
from ltm_core.surface.change import ChangeKind
from ltm_msgs_py.grid import msg_to_classes
from ltm_ros.fuel_map.services import FuelMapConfig
from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.nodes.terrain import TerrainHandler, TerrainNodeConfig
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import TERRAIN_CHANGE, camera_topic


def test_ground_that_has_moved_is_bare_in_the_fuel_map_and_nothing_else_is(tmp_path: Path) -> None:
    small = write_terrain_site(tmp_path)
    grid = small.site.in_crs(small.site.fuel_geometry(small.dem))
    write_geotiff(tmp_path / "wood.tif", np.full(grid.shape, 183, np.int16), grid, -9999)
    content = yaml.safe_load(small.path.read_text())
    content.setdefault("fuel", {})["prior"] = "wood.tif"
    small.path.write_text(yaml.safe_dump(content))
    sent = Kept()
    terrain = TerrainHandler(TerrainNodeConfig(site=str(small.path), depth_from_elsewhere=True), sent, Health())
    terrain.start()
    listens = {topic.name: callback for topic, callback in terrain.subscriptions.items()}
    for hours in (0, 2):
        for topic, message in measured_messages(small, sunk(small), BEGIN_NS + hours * HOUR).items():
            listens[camera_topic(NAME, "mast", topic)](message)
        terrain.idle()
    terrain.finish()

    health = Health()
    fuel = FuelMapHandler(FuelMapConfig(site=str(small.path)), Kept(), health)
    fuel.start()
    taken = dict(fuel.subscriptions)
    for topic, message in sent.sent:
        if topic in taken:
            taken[topic](message)
    assert health.dropped == {}
    layers = fuel.persistence.map.layers()
    changed = np.argwhere(layers.changed)
    assert len(changed) > 5
    assert set(layers.code[layers.changed].tolist()) == {99}
    kinds, window = msg_to_classes(sent.on(TERRAIN_CHANGE)[-1])
    lowered = np.argwhere(kinds == ChangeKind.LOWERED)
    row, col = small.site.fuel_geometry(small.dem).cell_of(*window.to_map(lowered[:, 0], lowered[:, 1]))
    assert {tuple(cell) for cell in changed.tolist()} <= set(zip(row.tolist(), col.tolist(), strict=True))
    assert layers.changed[row, col].mean() > 0.8, "nine cells of the terrain make one of the fuel map"
