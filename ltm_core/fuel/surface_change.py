"""Apply changes of the surface map to the fuel map: the affected fuel cells, and their new cover.

Where the surface has changed, the prior map no longer holds: such a cell starts from the code of what stands there now,
and what cameras had seen there before is void, as after a burn. From then on evidence works on it as on any cell."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import Float32Array, Int32Array, Int64Array, UInt8Array
from ltm_core.fuel.cell_state import TILE
from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.evidence import EvidenceMap, Window
from ltm_core.fuel.life_form import NODATA, LifeForm, forms_of, held
from ltm_core.fuel.prior import FuelPrior, system_of
from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.tile_store import Key
from ltm_core.storage.tile_store_schema import Tile
from ltm_core.surface.change import ChangeKind
from ltm_core.surface.layers import LEAST_SEEN, SHRUB_BELOW, FuelChange, SurfaceLayers, cover_after, fuel_changes

UNSEEN: Final = 255
"""Value in a grid of changes for cells that independent views have not seen."""
SOURCE: Final = "terrain"
"""Name under which the store records the source of a change; no camera may have it."""
_BLOCK: Final = 16
"""Number of fuel cells per side that are processed together."""
_CODES: Final = 1000
"""Factor of the recorded number of a cell: its kind of change times this, plus the initial code (0: its own)."""
_KEPT: Final = ("seen_by", "last_seen", "burned_at")
"""Fields of a cell's state that are reset when its cover is no longer known."""
_KINDS: Final = {
    FuelChange.REMOVED: ChangeKind.REMOVED,
    FuelChange.GROWN: ChangeKind.GROWN,
    FuelChange.MOVED_GROUND: ChangeKind.LOWERED,
}


class LivingFuelMap(EvidenceMap):
    """Evidence map whose prior is replaced where the surface has changed. Arguments as for `EvidenceMap`."""

    def __init__(self, geometry: GridGeometry, prior: FuelPrior | None, *arguments: Any, **named: Any) -> None:
        super().__init__(geometry, prior, *arguments, **named)
        self._given = prior
        self.surface_changes = np.zeros(geometry.shape, np.int32)
        """(H, W): recorded surface change of each cell, 0 for none."""

    @property
    def change_kinds(self) -> UInt8Array:
        """Return (H, W) ChangeKind."""
        return (self.surface_changes // _CODES).astype(np.uint8)

    def recall(self, recorded: NDArray[np.integer]) -> None:
        """Put back what `surface_changes` was, (H, W)."""
        self.surface_changes = recorded.astype(np.int32)
        codes = np.full(recorded.shape, NODATA, np.int16) if self._given is None else self._given.codes.copy()
        starts = self.surface_changes % _CODES
        codes[starts > 0] = starts[starts > 0]
        if self._given is not None:
            self.prior = replace(self._given, codes=codes)
        else:
            self.prior = FuelPrior(codes, self.geometry) if (starts > 0).any() else None

    def changed_otherwise(self, window: Window) -> UInt8Array | None:
        row, col, height, width = window
        recorded = self.surface_changes[row : row + height, col : col + width] % _CODES
        if not recorded.any():
            return None
        return np.where(recorded > 0, forms_of(recorded.astype(np.int16)).argmax(axis=-1) + 1, 0).astype(np.uint8)

    def layers(self, window: Window | None = None, at_ns: int | None = None) -> FuelLayers:
        """Return the layers as `EvidenceMap`; `prior` is the site's initial map."""
        found = super().layers(window, at_ns)
        row, col, height, width = window or (0, 0, *self.geometry.shape)
        part = slice(row, row + height), slice(col, col + width)
        other = self.surface_changes[part] % _CODES > 0
        if not other.any():
            return found
        given = np.full(found.code.shape, NODATA, np.int16) if self._given is None else self._given.codes[part].copy()
        return replace(found, prior=given)


@dataclass(frozen=True, eq=False)
class SurfaceNews:
    """Fuel cells whose change differs from the recorded one, (N,) each: row, col, `kind` (ChangeKind, NONE: reverted),
    and the median `shift` of the changed part in metres, NaN if unknown."""

    rows: Int64Array
    cols: Int64Array
    kind: UInt8Array
    shift: Float32Array

    def __len__(self) -> int:
        return len(self.rows)


def news_of(
    kinds: UInt8Array,
    shift: Float32Array,
    window: GridGeometry,
    fuel: GridGeometry,
    recorded: UInt8Array,
) -> SurfaceNews:
    """Return the changes in a part of the terrain's grid that the fuel cells do not have yet.

    Args:
        kinds: (h, w) ChangeKind, UNSEEN where independent views have not looked.
        shift: (h, w) metres from the reference surface, NaN where it is not known.
        window: their geometry, in the map frame.
        recorded: (H, W) ChangeKind of each cell of `fuel`, as it was recorded last (`LivingFuelMap.change_kinds`)."""
    fuel_rows = fuel.cell_of(0.0, window.to_map(np.arange(window.height), 0)[1])[0]
    fuel_cols = fuel.cell_of(window.to_map(0, np.arange(window.width))[0], 0.0)[1]
    found: dict[tuple[int, int], tuple[int, float]] = {}
    for row, col in _changed_cells(recorded, fuel_rows, fuel_cols):
        seen = kinds[_span(fuel_rows, row, row + 1), _span(fuel_cols, col, col + 1)] != UNSEEN
        if seen.sum() >= LEAST_SEEN * (fuel.resolution / window.resolution) ** 2:
            found[row, col] = int(ChangeKind.NONE), float("nan")
    for block_row, block_col in _blocks_changed(kinds, fuel_rows, fuel_cols):
        part = (
            _span(fuel_rows, block_row * _BLOCK, (block_row + 1) * _BLOCK),
            _span(fuel_cols, block_col * _BLOCK, (block_col + 1) * _BLOCK),
        )
        height, width = kinds[part].shape
        corner = window.window(part[0].start, part[1].start, height, width)
        for cell in fuel_changes(_as_layers(kinds[part], shift[part], corner), fuel):
            found[cell.row, cell.col] = int(_KINDS[cell.change]), cell.shift
    news = [(row, col, kind, by) for (row, col), (kind, by) in sorted(found.items()) if recorded[row, col] != kind]
    columns = np.array(news, np.float64).reshape(-1, 4).T
    rows, cols = columns[:2].astype(np.int64)
    return SurfaceNews(rows, cols, columns[2].astype(np.uint8), columns[3].astype(np.float32))


def record(evidence: LivingFuelMap, news: SurfaceNews) -> tuple[Int32Array, dict[Key, Tile]]:
    """Return the record of the cells of the news, (N,) (as in `LivingFuelMap.surface_changes`), and the resulting state
    of their tiles; `evidence` does not change.

    A cell that shows already what the change means keeps its evidence, as do burned cells and those that labels never
    change. A change that is taken back gives a cell its prior back."""
    recorded = news.kind.astype(np.int32) * _CODES
    tiles: dict[Key, Tile] = {}
    keys = np.stack([news.rows // TILE, news.cols // TILE], axis=-1)
    for key in sorted({(int(r), int(c)) for r, c in keys}):
        top, left = key[0] * TILE, key[1] * TILE
        height, width = (min(TILE, n - k) for n, k in zip(evidence.geometry.shape, (top, left), strict=True))
        layers = evidence.layers((top, left, height, width))
        state = tiles[key] = evidence.tile_state(key)
        stays = held(layers.prior, evidence.rules.mask)
        for i in np.flatnonzero((keys == key).all(axis=1)):
            cell = int(news.rows[i]) - top, int(news.cols[i]) - left
            before = int(evidence.surface_changes[news.rows[i], news.cols[i]]) % _CODES
            given, form = int(layers.prior[cell]), int(layers.life_form[cell])
            if news.kind[i] == ChangeKind.NONE or stays[cell]:
                continue
            last = state["last"][cell]
            shown = int(last.argmax()) + 1 if last.any() else UNSEEN
            now = form_after(ChangeKind(news.kind[i]), float(news.shift[i]), form, shown)
            if now is None:
                recorded[i] += before
                continue
            recorded[i] += _code_of(LifeForm(now), given, evidence)
            for name, array in state.items():
                if name not in _KEPT:
                    array[cell] = 0
    return recorded, tiles


def _code_of(form: LifeForm, given: int, evidence: LivingFuelMap) -> int:
    """Return the code of a cell that is now of `form`; 0 where its prior's is one of that form."""
    agreeing = forms_of(np.array([given], np.int16))[0]
    if agreeing[form - 1]:
        return 0
    codes = getattr(evidence.climate.changed, system_of(evidence.prior))
    return int(codes.of(np.array(form - 1), agreeing[LifeForm.SHRUB - 1]))


def form_after(kind: ChangeKind, shift: float, form: int, shown: int) -> int | None:
    """Return the life form of a cell of `form` whose surface has moved by `shift` metres (NaN unknown); None:
    unchanged.

    `shown`: what a camera showed there last, UNSEEN nothing. Where plants are gone and no camera says what is left, it
    is grass: a felled stand burns."""
    if form == LifeForm.BURNED:
        return None
    if kind == ChangeKind.LOWERED:
        return LifeForm.BARE if form in (LifeForm.GRASS, LifeForm.SHRUB, LifeForm.TREE) else None
    known = np.array([shown], np.uint8)
    if kind == ChangeKind.REMOVED:
        low = form == LifeForm.SHRUB and abs(shift) < SHRUB_BELOW
        if form != LifeForm.TREE and not low:
            return None
        cover = cover_after(kind, shift, known)
        return LifeForm.GRASS if cover is None or cover == form else cover
    height = 0.0 if np.isnan(shift) else shift
    if form in (LifeForm.TREE, LifeForm.BUILT) or (form == LifeForm.SHRUB and height < SHRUB_BELOW):
        return None
    cover = cover_after(kind, height, known)
    return None if cover == form else cover


def _span(cells: Int64Array, first: int, beyond: int) -> slice:
    """Return where the ascending `cells` lie in [first, beyond)."""
    return slice(int(np.searchsorted(cells, first)), int(np.searchsorted(cells, beyond)))


def _changed_cells(recorded: UInt8Array, rows: Int64Array, cols: Int64Array) -> list[tuple[int, int]]:
    """Return the fuel cells with a recorded change that the window touches."""
    known = np.argwhere(recorded > 0)
    inside = np.isin(known[:, 0], rows) & np.isin(known[:, 1], cols)
    return [(int(r), int(c)) for r, c in known[inside]]


def _blocks_changed(kinds: UInt8Array, rows: Int64Array, cols: Int64Array) -> list[tuple[int, int]]:
    """Return the blocks of fuel cells in which anything has changed."""
    row, col = np.nonzero((kinds > 0) & (kinds != UNSEEN))
    pairs = np.unique(np.stack([rows[row] // _BLOCK, cols[col] // _BLOCK]), axis=1)
    return [(int(r), int(c)) for r, c in pairs.T]


def _as_layers(kinds: UInt8Array, shift: Float32Array, window: GridGeometry) -> SurfaceLayers:
    """Return what the rule of both maps asks of: only changes, how far, and where anybody has looked."""
    seen = kinds != UNSEEN
    flat: NDArray[Any] = np.zeros(kinds.shape, np.float32)
    given: dict[str, Any] = {field.name: flat for field in fields(SurfaceLayers)}
    given |= {"geometry": window, "height": shift, "observed": seen, "change": np.where(seen, kinds, 0)}
    given |= {"since": np.zeros(kinds.shape, np.uint32), "by": np.zeros(kinds.shape, np.uint32)}
    return SurfaceLayers(**given | {"label": np.full(kinds.shape, UNSEEN, np.uint8)})
