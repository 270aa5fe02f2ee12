"""What the node `fuel_map` offers: its parameters and topics, and its services (query a point, burn a region)."""

import math
from typing import Any

import numpy as np

from ltm_core.base.errors import ImageError, MessageError
from ltm_core.base.types import BoolArray
from ltm_core.fuel.codes import fuel_models
from ltm_core.fuel.evidence import TILE, EvidenceMap, Window
from ltm_core.fuel.life_form import NODATA
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.storage.tile_store import Key, TileStore
from ltm_core.storage.tile_store_schema import Tile
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.cells import fuel_cells_to_msg
from ltm_msgs_py.grid import classes_to_msg, tile_to_msg
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.fuel_map.persistence import CountedFrame, FuelMapPersistence
from ltm_ros.runtime.handler import Outlet
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.stamp_check import StampLimits
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
        if (unsaved := self._persistence.unsaved_frames) > 0:
            self._map_due = self._cells_due = True
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
        self._health.gauge("cells.seen", int(shown.seen.sum()))
        self._health.gauge("cells.changed", int(shown.changed.sum()))
        self._outlet.publish(FUEL_MAP, classes_to_msg(shown.life_form, self._geometry, self._persistence.map.newest_ns))

    def send_cells(self) -> None:
        """Publish all layers of the cells with evidence, if the topic has subscribers."""
        if not self._outlet.wanted(FUEL_MAP_CELLS):
            return
        self._cells_due, self._since_cells = False, 0.0
        evidence = self._persistence.map
        message = fuel_cells_to_msg(evidence.layers(), self._heights, self._geometry, evidence.newest_ns)
        self._outlet.publish(FUEL_MAP_CELLS, message)


class FuelMapConfig(StampLimits):
    folder: str = ""
    """Folder in which the map is kept between runs and written on request, relative to the site file. Empty: not kept.
    Never set by a message."""
    export_path: str = ""
    """GeoTIFF that the `save` service and a clean stop write; empty: `fuel_map.tif` in `folder`, on request only."""
    allow_burn: bool = False
    """Whether to serve `fuel_map/burn`, with which any node in the graph can mark regions of the map as burned."""


MOST_CORNERS = 1000


def answer(evidence: EvidenceMap, store: TileStore | None, classes: LabelSet, x: float, y: float) -> dict[str, Any]:
    """Return everything known of the cell at map coordinates (x, y), and the sources of its tile, ready for JSON.
    Raises MessageError for a point outside the map."""
    geometry = evidence.geometry
    if not (math.isfinite(x) and math.isfinite(y)):
        raise MessageError(f"query at ({x}, {y}): give finite coordinates")
    row, col = (round(float(index)) if abs(float(index)) < 1e9 else -1 for index in geometry.to_grid(x, y))
    if not geometry.contains(row, col):
        raise MessageError(f"query at ({x}, {y}) is outside the fuel map, {geometry.bounds} in the map frame")
    cell = {name: layer.item() for name, layer in vars(evidence.layers((row, col, 1, 1))).items()}
    prior, fuel = (
        None if code == NODATA else {"code": code, "name": fuel_models().name(code)}
        for code in (cell["prior"], cell["code"])
    )
    touches = [] if store is None else store.touches((row // TILE, col // TILE))
    return {
        "row": row,
        "col": col,
        "prior": prior,
        "fuel": fuel,
        "life_form": classes.name_of(cell["life_form"]),
        "p_max": None if math.isnan(cell["p_max"]) else round(cell["p_max"], 4),
        "entropy": round(cell["entropy"], 4),
        "evidence": round(cell["evidence"], 3),
        "changed": prior is not None and cell["code"] != cell["prior"],
        "last_seen_ns": cell["last_seen"],
        "seen_by": cell["seen_by"],
        "tile": [
            {"camera": t.source, "model": t.model, "frames": t.frames, "first_ns": t.first_ns, "last_ns": t.last_ns}
            for t in touches
        ],
    }


def region_of(message: Any, geometry: GridGeometry) -> tuple[BoolArray, int]:
    """Return the cells (H, W) of the map whose centres lie in a PolygonStamped, and its stamp, 0 for none. Raises
    MessageError for another frame, an invalid polygon, or one without cells."""
    from rasterio.features import geometry_mask

    corners = [(float(p.x), float(p.y)) for p in message.polygon.points[: MOST_CORNERS + 1]]
    if message.header.frame_id != "map":
        raise MessageError(f"region is in frame {message.header.frame_id!r}, expected 'map'")
    if not 3 <= len(corners) <= MOST_CORNERS or not np.isfinite(corners).all():
        raise MessageError(f"region has {len(corners)} corners; give 3 to {MOST_CORNERS} finite ones")
    shape = {"type": "Polygon", "coordinates": [[*corners, corners[0]]]}
    cells = np.asarray(geometry_mask([shape], geometry.shape, geometry.transform(), invert=True), np.bool_)
    if not cells.any():
        raise MessageError(
            f"region from {corners[0]} on contains no cell of the map, {geometry.bounds} in the map frame"
        )
    return cells, stamp_of(message)


def burned(evidence: EvidenceMap, cells: BoolArray, stamp_ns: int) -> tuple[dict[Key, Tile], Window]:
    """Return the state of the tiles of these cells, burned at that time, and the bounds of the cells. Raises
    MessageError for an invalid time."""
    try:
        evidence.burn(cells, stamp_ns)
    except ImageError as error:
        raise MessageError(str(error)) from error
    places = np.argwhere(cells)
    keys = sorted({(int(row) // TILE, int(col) // TILE) for row, col in places})
    (top, left), (bottom, right) = places.min(axis=0).tolist(), places.max(axis=0).tolist()
    return {key: evidence.tile_state(key) for key in keys}, (top, left, bottom - top + 1, right - left + 1)
