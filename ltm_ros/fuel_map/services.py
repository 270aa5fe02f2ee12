"""Serve requests of the node `fuel_map`: query a point, mark a region burned, clear a region, write landscapes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import ImageError, MessageError
from ltm_core.base.types import BoolArray, Int16Array
from ltm_core.fuel.cell_state import TILE
from ltm_core.fuel.codes import fuel_models
from ltm_core.fuel.evidence import EvidenceMap, Window
from ltm_core.fuel.export.companion_files_io import write_item
from ltm_core.fuel.export.export_grid import make_landscape
from ltm_core.fuel.export.landscape_io import write_landscape, write_lcp
from ltm_core.fuel.export.provenance import landscape_units
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.prior import system_of
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pipeline.site_fuel import provenance_of, site_canopy, spare_heights
from ltm_core.pipeline.site_surface import exported_terrain
from ltm_core.site.site import Site
from ltm_core.storage.tile_store import Key, TileStore
from ltm_core.storage.tile_store_schema import Tile
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.stamp import stamp_of

MOST_CORNERS = 1000


def answer(evidence: EvidenceMap, store: TileStore | None, classes: LabelSet, x: float, y: float) -> dict[str, Any]:
    """Return everything known of the cell at map coordinates (x, y), and the sources of its tile, ready for JSON.
    Raises MessageError for a point outside the map."""
    geometry = evidence.geometry
    if not (math.isfinite(x) and math.isfinite(y)):
        raise MessageError(f"query at ({x}, {y}): give finite coordinates")
    fractional = geometry.to_grid(x, y)
    row, col = (round(float(index)) if abs(float(index)) < 1e9 else -1 for index in fractional)
    if not geometry.contains(row, col):
        raise MessageError(f"query at ({x}, {y}) is outside the fuel map, {geometry.bounds} in the map frame")
    layers = evidence.layers((row, col, 1, 1))
    models = fuel_models()

    def code_of(layer: Int16Array) -> dict[str, Any] | None:
        code = int(layer[0, 0])
        return None if code == NODATA else {"code": code, "name": models.name(code)}

    p_max = float(layers.p_max[0, 0])
    touches = [] if store is None else store.touches((row // TILE, col // TILE))
    return {
        "row": row,
        "col": col,
        "prior": code_of(layers.prior),
        "fuel": code_of(layers.code),
        "life_form": classes.name_of(int(layers.life_form[0, 0])),
        "p_max": None if math.isnan(p_max) else round(p_max, 4),
        "entropy": round(float(layers.entropy[0, 0]), 4),
        "evidence": round(float(layers.evidence[0, 0]), 3),
        "changed": bool(layers.changed[0, 0]),
        "last_seen_ns": int(layers.last_seen[0, 0]),
        "seen_by": int(layers.seen_by[0, 0]),
        "tile": [
            {"camera": t.source, "model": t.model, "frames": t.frames, "first_ns": t.first_ns, "last_ns": t.last_ns}
            for t in touches
        ],
    }


@dataclass(frozen=True, eq=False)
class DrawnRegion:
    """A region of the map that was drawn: `cells` (H, W) whose centres lie inside, one or more; its stamp, 0 for
    none."""

    cells: BoolArray
    stamp_ns: int

    @property
    def window(self) -> Window:
        """Return row, col, height, width of its bounds."""
        rows, cols = np.nonzero(self.cells)
        top, left = int(rows.min()), int(cols.min())
        return top, left, int(rows.max()) - top + 1, int(cols.max()) - left + 1


def region_of(message: Any, geometry: GridGeometry) -> DrawnRegion:
    """Return the cells in a PolygonStamped. Raises MessageError for another frame, an invalid polygon, or one without
    cells."""
    corners = [(float(p.x), float(p.y)) for p in message.polygon.points[: MOST_CORNERS + 1]]
    if message.header.frame_id != "map":
        raise MessageError(f"region is in frame {message.header.frame_id!r}, expected 'map'")
    if not 3 <= len(corners) <= MOST_CORNERS or not np.isfinite(corners).all():
        raise MessageError(f"region has {len(corners)} corners; give 3 to {MOST_CORNERS} finite ones")
    cells = _cells_in(corners, geometry)
    if not cells.any():
        raise MessageError(
            f"region from {corners[0]} on contains no cell of the map, {geometry.bounds} in the map frame"
        )
    return DrawnRegion(cells, stamp_of(message))


def _cells_in(polygon: Sequence[tuple[float, float]], geometry: GridGeometry) -> BoolArray:
    """Return (H, W): cells whose centres lie inside."""
    from rasterio.features import geometry_mask

    shape = {"type": "Polygon", "coordinates": [[*polygon, polygon[0]]]}
    inside = geometry_mask([shape], geometry.shape, geometry.transform(), invert=True)
    return np.asarray(inside, np.bool_)


def burned(evidence: EvidenceMap, cells: BoolArray, stamp_ns: int) -> dict[Key, Tile]:
    """Return the state of the tiles of these cells, burned at that time. Raises MessageError for an invalid time."""
    try:
        evidence.burn(cells, stamp_ns)
    except ImageError as error:
        raise MessageError(str(error)) from error
    return {key: evidence.tile_state(key) for key in _tiles_of(cells)}


def _tiles_of(cells: BoolArray) -> list[Key]:
    return sorted({(int(row) // TILE, int(col) // TILE) for row, col in np.argwhere(cells)})


def forgotten(evidence: EvidenceMap, cells: BoolArray) -> dict[Key, Tile]:
    """Return the state of the tiles of these cells without evidence."""
    tiles = {}
    for row, col in _tiles_of(cells):
        state = evidence.tile_state((row, col))
        inside = np.zeros((TILE, TILE), np.bool_)
        part = cells[row * TILE : (row + 1) * TILE, col * TILE : (col + 1) * TILE]
        inside[: part.shape[0], : part.shape[1]] = part
        for array in state.values():
            array[inside] = 0
        tiles[row, col] = state
    return tiles


def write_landscapes(evidence: EvidenceMap, site: Site, folder: Path, state: Path) -> list[Path]:
    """Write the map as `landscape.lcp` and `landscape.tif`, for fire models, with their STAC items. `state`: folder of
    its store, and of the confirmed surface if used. Raises ConfigError, RasterError, StoreError."""
    system = system_of(evidence.prior)
    layers, terrain = evidence.layers(), exported_terrain(site, state)
    canopy = site_canopy(site, evidence.geometry, layers, evidence.prior, evidence.climate, terrain, evidence, state)
    landscape = make_landscape(
        layers,
        evidence.prior,
        terrain.ground,
        site.frame,
        site.in_crs(evidence.geometry),
        evidence.climate,
        system,
        spare=spare_heights(site, evidence.geometry),
        seen=canopy.seen,
    )
    made = provenance_of(site, layers, system, landscape=landscape, surface=terrain.version, prior=evidence.prior)
    lcp = write_lcp(folder / "landscape.lcp", landscape, made.line())
    tif = write_landscape(folder / "landscape.tif", landscape, made.tags() | landscape_units())
    for path, files in ((lcp, [lcp, lcp.with_suffix(".prj")]), (tif, [tif])):
        write_item(path, files, landscape.geometry, made)
    return [lcp, tif]
