"""Store the fuel map of a site and restore it after any stop; apply changes of the surface to it."""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import UInt8Array
from ltm_core.fuel.evidence import EVIDENCE_FIELDS, EVIDENCE_VERSION, TILE, EvidenceMap, Window
from ltm_core.fuel.surface_change import SurfaceNews, news_of, record
from ltm_core.fuel.votes import CellVisibility, CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.site.site import Site
from ltm_core.storage.config_io import load_array
from ltm_core.storage.tile_store import Key, TileStore
from ltm_core.storage.tile_store_schema import CellChanges, FrameRecord, StoreSchema, Tile
from ltm_core.surface.change import Changed

STORE_KIND: Final = "fuel"
STORE_FILE: Final = "fuel_map.ltm"
"""Name of a site's store in the folder of its fuel map."""
JOURNALED: Final = ("life_form", "code")
"""Layers whose changes are in the store's journal."""
_ALWAYS: Final = 2**63 - 1
SURFACE_LAYER: Final = "surface"
"""Journal layer with the recorded surface change of each cell (`EvidenceMap.surface_changes`)."""
_VISIBILITY = ("cos_incidence", "footprint", "sigma_along", "sigma_across", "bearing")


def fuel_schema(site: Site, geometry: GridGeometry) -> StoreSchema:
    """Return the schema of the store of a site's map; `geometry`: the fuel grid in the map frame.

    It does not depend on the rules of fusion: evidence is stored, and weighted when the map is read."""
    return StoreSchema(STORE_KIND, EVIDENCE_VERSION, site.in_crs(geometry), TILE, dict(EVIDENCE_FIELDS))


def restore(store: TileStore, evidence: EvidenceMap) -> set[Key]:
    """Fill an empty map with a store's content; return the tiles that the store does not have in their last state.

    Raises ConfigError where the store is damaged, StoreError where it cannot be read just now."""
    for key, tile in store.tiles():
        evidence.load_tile(key, tile)
    evidence.recall(store.as_of(SURFACE_LAYER, np.zeros_like(evidence.surface_changes), _ALWAYS))
    newer: set[Key] = set()
    for frame in store.waiting():
        window = evidence.add(votes_of(frame, evidence.geometry))
        if window is not None:
            newer.update(evidence.tiles_of(window))
    return newer


def open_stored_map(path: Path | str, site: Site, empty: EvidenceMap) -> TileStore:
    """Open a site's store for reading, also while a node writes it; fills the `empty` map of the site.

    The map as of an earlier date: `store.as_of("code", layers.code, until_ns)` with the empty map's layers. Raises
    ConfigError for another site's store and as `restore` does."""
    store = TileStore.open_read_only(path, STORE_KIND)
    try:
        schema = fuel_schema(site, empty.geometry)
        if differences := schema.differences(store.schema):
            raise ConfigError(f"{path}: not the store of this site's fuel map: {differences}")
        restore(store, empty)
    except BaseException:
        store.close()
        raise
    return store


def votes_to_bytes(votes: CellVotes) -> bytes:
    """Return all of a frame's votes, without the grid, their source and stamp, losslessly."""
    columns: dict[str, NDArray[Any]] = {"row": votes.rows, "col": votes.cols, "z": votes.z, "counts": votes.counts}
    if votes.confidence is not None:
        columns["confidence"] = votes.confidence
    if votes.visibility is not None:
        columns |= dict(zip(_VISIBILITY, votes.visibility.columns(), strict=True))
    table = np.empty(len(votes), [(name, column.dtype, column.shape[1:]) for name, column in columns.items()])
    for name, column in columns.items():
        table[name] = column
    file = io.BytesIO()
    np.save(file, table, allow_pickle=False)
    return file.getvalue()


def votes_of(frame: FrameRecord, geometry: GridGeometry) -> CellVotes:
    """Return the votes of a frame that waits in a store. Raises ConfigError on an invalid payload."""
    what = f"the store's frame {frame.stamp_ns} of {frame.source}"
    table = load_array(frame.payload, what, ConfigError)
    try:
        row, col, z, counts = (np.ascontiguousarray(table[name]) for name in ("row", "col", "z", "counts"))
        names = table.dtype.names or ()
        confidence = np.ascontiguousarray(table["confidence"]) if "confidence" in names else None
        visibility = None
        if _VISIBILITY[0] in names:
            visibility = CellVisibility(*(np.ascontiguousarray(table[name]) for name in _VISIBILITY))
        return CellVotes(geometry, row, col, counts, z, frame.stamp_ns, frame.source, confidence, visibility)
    except (ValueError, IndexError, TypeError) as error:
        raise ConfigError(f"{what} is damaged ({error}); restore the store from a copy") from error


class SurfaceMoves:
    """Movement of the surface by cell of the terrain's `grid` (in the map frame), as received so far."""

    def __init__(self, grid: GridGeometry) -> None:
        self._grid = grid
        self._shift = np.zeros(grid.shape, np.float32)  # 0: not known; untouched pages take no memory

    def take(self, changed: Changed) -> None:
        """Add cells with new changes, which must be in the grid."""
        self._shift[changed.rows, changed.cols] = np.where(changed.kind > 0, changed.shift, 0)

    def news(self, kinds: UInt8Array, window: Window, evidence: EvidenceMap) -> SurfaceNews:
        """Return the news for a fuel map in the kinds of change (`SurfaceLayers.told`) of a window (row, col, height,
        width) of the grid."""
        row, col, height, width = window
        shift = self._shift[row : row + height, col : col + width]
        known = np.where(shift != 0, shift, np.float32(np.nan))
        return news_of(kinds, known, self._grid.window(*window), evidence.geometry, evidence.change_kinds)


@dataclass(frozen=True, eq=False)
class RecordedNews:
    """News applied to a map: the state of the tiles that they void, which replaces the map's; the entries for its
    journal; and the affected window (row, col, height, width) of the fuel grid."""

    tiles: Mapping[Key, Tile]
    change: CellChanges
    window: Window


def take_news(evidence: EvidenceMap, news: SurfaceNews, stamp_ns: int) -> RecordedNews:
    """Restart a map from the present surface in the cells of the news, which must not be empty."""
    recorded, tiles = record(evidence, news)
    cells = news.rows, news.cols
    change = CellChanges(SURFACE_LAYER, stamp_ns, *cells, evidence.surface_changes[cells], recorded)
    whole = evidence.surface_changes.copy()
    whole[cells] = recorded
    evidence.recall(whole)
    top, left = int(news.rows.min()), int(news.cols.min())
    window = top, left, int(news.rows.max()) - top + 1, int(news.cols.max()) - left + 1
    return RecordedNews(tiles, change, window)
