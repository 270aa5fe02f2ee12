"""Publish the fuel map: changed tiles, the whole map, and all its layers, each at a limited rate."""

from __future__ import annotations

import numpy as np

from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_msgs_py.cells import fuel_cells_to_msg
from ltm_msgs_py.grid import classes_to_msg, tile_to_msg
from ltm_ros.fuel_map.persistence import CountedFrame, FuelMapPersistence
from ltm_ros.runtime.handler import Outlet
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import FUEL_MAP, FUEL_MAP_CELLS, FUEL_MAP_UPDATE

MAP_CELLS_PER_S = 1_000_000
"""Cells per second of the latched map: a large map is published less often than twice a second."""
CELLS_EVERY_S = 2.0
"""Minimum seconds between messages of all layers, which cost ten times as much as the map."""


class FuelPublisher:
    """Publishes only what the persistence has acknowledged or shows. `geometry`: of the fuel grid over `dem`, map
    frame."""

    publications = (FUEL_MAP, FUEL_MAP_UPDATE, FUEL_MAP_CELLS)

    def __init__(
        self, outlet: Outlet, health: Health, persistence: FuelMapPersistence, geometry: GridGeometry, dem: Dem
    ) -> None:
        self._outlet, self._health, self._persistence, self._geometry = outlet, health, persistence, geometry
        self._heights = dem.elevation_at(*geometry.to_map(*np.indices(geometry.shape)))
        self._since_map = self._since_cells = 0.0
        self._map_due = self._cells_due = True

    def announce(self, saved: list[CountedFrame]) -> None:
        """Publish frames that are now in the store."""
        for counted in saved:
            if counted.window is not None:
                self._map_due = self._cells_due = True
                tile = tile_to_msg(
                    self._persistence.shown.life_form, self._geometry, counted.window, counted.record.stamp_ns
                )
                self._outlet.publish(FUEL_MAP_UPDATE, tile)
        unsaved = self._persistence.unsaved_frames
        self._map_due |= unsaved > 0
        self._cells_due |= unsaved > 0
        self._health.gauge("frames", self._persistence.saved_frames)
        self._health.gauge("unsaved_frames", unsaved)

    def tick(self, waited: float) -> None:
        """Publish the map and the layers when they are due."""
        self._since_map += waited
        self._since_cells += waited
        pace = self._geometry.width * self._geometry.height / MAP_CELLS_PER_S
        if self._map_due and self._since_map >= pace:
            self.send_map()
        if self._cells_due and self._since_cells >= max(CELLS_EVERY_S, 10 * pace):
            self.send_cells()

    def send_map(self) -> None:
        self._map_due, self._since_map = False, 0.0
        shown = self._persistence.shown
        self._health.gauge("cells.all", shown.life_form.size)
        self._health.gauge("cells.seen", shown.seen_cells)
        self._health.gauge("cells.changed", shown.changed_cells)
        self._outlet.publish(FUEL_MAP, classes_to_msg(shown.life_form, self._geometry, self._persistence.map.newest_ns))

    def send_cells(self) -> None:
        """Publish all layers of the cells with evidence, if the topic has subscribers."""
        if not self._outlet.wanted(FUEL_MAP_CELLS):
            return
        self._cells_due, self._since_cells = False, 0.0
        evidence = self._persistence.map
        message = fuel_cells_to_msg(evidence.layers(), self._heights, self._geometry, evidence.newest_ns)
        self._outlet.publish(FUEL_MAP_CELLS, message)
