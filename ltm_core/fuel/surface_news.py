"""What the surface map tells the fuel map, and what that records: the same live, replayed and in an archive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ltm_core.fuel.evidence import Window
from ltm_core.fuel.stored_map import SURFACE_LAYER
from ltm_core.fuel.surface_change import LivingFuelMap, SurfaceNews, news_of, record
from ltm_core.grid import GridGeometry
from ltm_core.raster.tile_store import CellChanges, Key, Tile
from ltm_core.terrain.change import Changed
from ltm_core.types import UInt8Array


class SurfaceMoves:
    """How far the surface has moved, by cell of the terrain's `grid` (in the map frame), as far as it was told."""

    def __init__(self, grid: GridGeometry) -> None:
        self._grid = grid
        self._shift = np.zeros(grid.shape, np.float32)  # 0: not known; untouched pages take no memory

    def take(self, changed: Changed) -> None:
        """Cells whose change is new, which must lie in the grid."""
        self._shift[changed.rows, changed.cols] = np.where(changed.kind > 0, changed.shift, 0)

    def news(self, kinds: UInt8Array, window: Window, evidence: LivingFuelMap) -> SurfaceNews:
        """What the kinds of change (`SurfaceLayers.told`) in a window (row, col, height, width) of the grid are news
        of to a fuel map."""
        row, col, height, width = window
        shift = self._shift[row : row + height, col : col + width]
        known = np.where(shift != 0, shift, np.float32(np.nan))
        return news_of(kinds, known, self._grid.window(*window), evidence.geometry, evidence.change_kinds)


@dataclass(frozen=True, eq=False)
class RecordedNews:
    """News that the map has taken: the state of the tiles that they void, to be put in place of the map's; what belongs
    into its journal; and the window (row, col, height, width) of the fuel grid that they touch."""

    tiles: Mapping[Key, Tile]
    change: CellChanges
    window: Window


def take_news(evidence: LivingFuelMap, news: SurfaceNews, stamp_ns: int) -> RecordedNews:
    """Have a map start from what stands now in the cells of the news, of which there must be some."""
    recorded, tiles = record(evidence, news)
    cells = news.rows, news.cols
    change = CellChanges(SURFACE_LAYER, stamp_ns, *cells, evidence.surface_changes[cells], recorded)
    whole = evidence.surface_changes.copy()
    whole[cells] = recorded
    evidence.recall(whole)
    top, left = int(news.rows.min()), int(news.cols.min())
    window = top, left, int(news.rows.max()) - top + 1, int(news.cols.max()) - left + 1
    return RecordedNews(tiles, change, window)
