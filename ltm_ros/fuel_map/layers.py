"""Keep the layers of the fuel map as of the last refresh, and draw them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import ConfigError, PoseError, RasterError
from ltm_core.base.types import BoolArray, Float32Array, Int16Array, UInt8Array
from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.evidence import EvidenceMap, Window
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.fuel_maps import FuelCanvas
from ltm_core.pictures.maps import MapCamera
from ltm_core.pipeline.stored_fuel import JOURNALED
from ltm_core.raster.dem import Dem
from ltm_core.site.site import Site
from ltm_core.storage.tile_store import TileStore
from ltm_core.storage.tile_store_schema import CellChanges


class ShownLayers:
    """Life form and code as of the last refresh, and which cells are seen and changed, (H, W) each; computing them for
    every frame would cost too much."""

    def __init__(self, evidence: EvidenceMap) -> None:
        self._evidence = evidence
        layers = evidence.layers()
        self.life_form: UInt8Array = layers.life_form
        self.code: Int16Array = layers.code
        self.seen, self.changed = layers.evidence > 0, layers.changed

    def refresh(self, windows: Sequence[Window]) -> list[CellChanges]:
        """Recompute these parts of the map, in one window unless they are far apart; return what has changed."""
        if len(windows) > 1:
            row, col = min(w[0] for w in windows), min(w[1] for w in windows)
            height, width = max(w[0] + w[2] for w in windows) - row, max(w[1] + w[3] for w in windows) - col
            if height * width <= sum(w[2] * w[3] for w in windows):
                windows = [(row, col, height, width)]
        found = []
        for row, col, height, width in windows:
            part = slice(row, row + height), slice(col, col + width)
            layers = self._evidence.layers((row, col, height, width))
            for name in JOURNALED:
                shown, now = getattr(self, name)[part], getattr(layers, name)
                found += _changes(name, shown, now, (row, col), self._evidence.newest_ns)
                shown[...] = now
            self.seen[part], self.changed[part] = layers.evidence > 0, layers.changed
        return found

    def refresh_all(self, evidence: EvidenceMap | None = None) -> list[CellChanges]:
        """Recompute everything, because time alone changes cells: evidence decays, and vegetation grows back on
        burns. `evidence`: another map of the same grid to show from now on."""
        self._evidence = evidence or self._evidence
        return self.refresh([(0, 0, *self._evidence.geometry.shape)])

    def missing_from(self, journal: TileStore, initial: Mapping[str, NDArray[Any]]) -> list[CellChanges]:
        """Return how the layers differ from the `initial` ones (without evidence) with the journal applied, stamped one
        nanosecond after the latest frame, so that the map as of that frame stays as shown."""
        found = []
        for name in JOURNALED:
            recorded = journal.as_of(name, initial[name], 2**63 - 1)
            found += _changes(name, recorded, getattr(self, name), (0, 0), self._evidence.newest_ns + 1)
        return found

    def copies(self) -> dict[str, NDArray[Any]]:
        return {name: getattr(self, name).copy() for name in JOURNALED}


def _changes(
    layer: str, old: NDArray[Any], new: NDArray[Any], corner: tuple[int, int], stamp: int
) -> list[CellChanges]:
    rows, cols = np.nonzero(old != new)
    changes = CellChanges(layer, stamp, rows + corner[0], cols + corner[1], old[rows, cols], new[rows, cols])
    return [changes] if len(rows) else []


def places_of(site: Site, dem: Dem) -> list[MapCamera]:
    """Return the cameras with positions in the site file, in the map frame."""
    found = []
    for name, camera in site.cameras.items():
        if camera.pose is not None:
            try:
                x, y, _ = camera.pose.pose(dem, site.frame).position
            except PoseError:
                continue
            found.append(MapCamera(name, None, (float(x), float(y))))
    return found


def canvas_of(
    site: Site,
    dem: Dem,
    geometry: GridGeometry,
    places: Sequence[MapCamera] | None = None,
    bounds: tuple[float, float, float, float] | None = None,
) -> FuelCanvas:
    """Return a canvas for layers on `geometry`, a fuel grid in the map frame, over the site's `dem`; axes in the site's
    CRS."""
    shown = places_of(site, dem) if places is None else places
    return FuelCanvas(geometry, Dem(dem.elevation, dem.geometry), shown, bounds, site.origin, about=site.crs)


def when(text: str) -> int:
    """Parse a date (its end) or an ISO 8601 time, UTC by default, to nanoseconds. Raises ConfigError."""
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise ConfigError(f"{text!r} is not a date; give 2026-05-31 or 2026-05-31T12:00:00Z") from error
    moment = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
    end = 86400 if len(text) == len("2026-05-31") else 1
    return (int(moment.timestamp()) + end) * 10**9 - 1


def layers_as_of(store: TileStore, empty: FuelLayers, until_ns: int) -> FuelLayers:
    """Return codes and life forms of the map as of a past time, without confidences. `empty`: the layers without
    evidence."""
    found = {name: store.as_of(name, getattr(empty, name), until_ns) for name in JOURNALED}
    unknown: Float32Array = np.full(empty.code.shape, np.nan, np.float32)
    return replace(empty, **found, p_max=unknown, entropy=unknown.copy())


def seen_window(
    geometry: GridGeometry, cells: BoolArray, places: Sequence[MapCamera]
) -> tuple[float, float, float, float]:
    """Return the bounds of the marked cells (H, W) and the cameras, with a margin of five cells; of all cells if none
    is marked. Raises RasterError if shapes differ."""
    if cells.shape != geometry.shape:
        raise RasterError(f"cells of {cells.shape} do not fit a fuel grid of {geometry.shape}")
    rows, cols = np.nonzero(cells)
    x, y = geometry.to_map(rows, cols)
    xs, ys = [*x.tolist(), *(p.position[0] for p in places)], [*y.tolist(), *(p.position[1] for p in places)]
    if not xs:
        return geometry.bounds
    margin = 5 * geometry.resolution
    west, east = max(min(xs) - margin, geometry.x_min), min(max(xs) + margin, geometry.x_max)
    south, north = max(min(ys) - margin, geometry.y_min), min(max(ys) + margin, geometry.y_max)
    return west, south, east, north
