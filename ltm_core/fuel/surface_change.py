"""Apply changes of the surface map to the fuel map: the affected fuel cells, and their new cover.

Where the surface has changed, the prior map no longer holds: such a cell starts from the code of what stands there now,
and what cameras had seen there before is void, as after a burn. From then on evidence works on it as on any cell."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, Int32Array, Int64Array, UInt8Array
from ltm_core.fuel.evidence import SURFACE_KINDS, TILE, EvidenceMap
from ltm_core.fuel.life_form import LifeForm, forms_of, held
from ltm_core.fuel.prior import system_of
from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.tile_store import Key
from ltm_core.storage.tile_store_schema import Tile
from ltm_core.surface.change import ChangeKind
from ltm_core.surface.layers import UNSEEN

SOURCE: Final = "terrain"
"""Name under which the store records the source of a change; no camera may have it."""
LEAST_SHARE: Final = 0.25
"""Minimum share of the seen part of a fuel cell that must have changed in one way."""
LEAST_SEEN: Final = 0.1
"""Minimum share of a fuel cell that independent views must have seen."""
SHRUB_BELOW: Final = 3.0
"""Height in metres below which new growth is shrub if no label contradicts."""
_CHANGES: Final = (ChangeKind.REMOVED, ChangeKind.GROWN, ChangeKind.LOWERED)
_KEPT: Final = ("seen_by", "last_seen", "burned_at")
"""Fields of a cell's state that stay when its cover is no longer known."""


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
    kinds: UInt8Array, shift: Float32Array, window: GridGeometry, fuel: GridGeometry, recorded: UInt8Array
) -> SurfaceNews:
    """Return the changes in a part of the terrain's grid that the fuel cells do not have yet.

    Args:
        kinds: (h, w) ChangeKind, UNSEEN where independent views have not looked; `window`: geometry in the map frame.
        shift: (h, w) metres from the reference surface, NaN where it is not known.
        recorded: (H, W) ChangeKind of each cell of `fuel`, as it was recorded last (`EvidenceMap.change_kinds`)."""
    x, y = window.to_map(0, np.arange(window.width))[0], window.to_map(np.arange(window.height), 0)[1]
    row_at, first_row = np.unique(fuel.cell_of(0.0, y)[0], return_index=True)
    col_at, first_col = np.unique(fuel.cell_of(x, 0.0)[1], return_index=True)

    def counted(cells: BoolArray) -> Int32Array:
        return np.add.reduceat(np.add.reduceat(cells, first_col, axis=1, dtype=np.int32), first_row, axis=0)

    seen = counted(kinds != UNSEEN)
    counts = np.stack([counted(kinds == one) for one in _CHANGES])
    most = counts.max(axis=0)
    shown = (most > 0) & (most >= LEAST_SHARE * seen)
    now = np.where(shown, counts.argmax(axis=0) + 1, ChangeKind.NONE).astype(np.uint8)
    judged = seen >= LEAST_SEEN * (fuel.resolution / window.resolution) ** 2
    row, col = np.nonzero(judged & fuel.contains(row_at[:, None], col_at))
    new = now[row, col] != recorded[row_at[row], col_at[col]]
    row, col = row[new], col[new]
    ends = np.append(first_row[1:], window.height), np.append(first_col[1:], window.width)
    by = np.full(len(row), np.nan, np.float32)
    for k, (r, c) in enumerate(zip(row, col, strict=True)):
        if now[r, c]:
            part = np.s_[first_row[r] : ends[0][r], first_col[c] : ends[1][c]]
            by[k] = np.median(shift[part][kinds[part] == now[r, c]])
    return SurfaceNews(row_at[row], col_at[col], now[row, col], by)


def record(evidence: EvidenceMap, news: SurfaceNews) -> tuple[Int32Array, dict[Key, Tile]]:
    """Return the record of the cells of the news, (N,) (as in `EvidenceMap.surface_changes`), and the resulting state
    of their tiles; `evidence` does not change. A cell that shows already what the change means keeps its evidence, as
    do burned cells and those that labels never change. A change that is taken back gives a cell its prior back."""
    recorded = news.kind.astype(np.int32) * SURFACE_KINDS
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
            before = int(evidence.surface_changes[news.rows[i], news.cols[i]]) % SURFACE_KINDS
            given, form = int(layers.prior[cell]), int(layers.life_form[cell])
            if news.kind[i] == ChangeKind.NONE or stays[cell]:
                continue
            last = state["last"][cell]
            shown = int(last.argmax()) + 1 if last.any() else UNSEEN
            now = form_after(ChangeKind(news.kind[i]), float(news.shift[i]), form, shown)
            if now is None:
                recorded[i] += before
                continue
            agreeing = forms_of(np.array([given], np.int16))[0]
            if not agreeing[now - 1]:  # otherwise its prior's code is one of that form
                codes = evidence.climate.changed[system_of(evidence.prior)]
                recorded[i] += int(codes.of(np.array(now - 1), agreeing[LifeForm.SHRUB - 1]))
            for name, array in state.items():
                if name not in _KEPT:
                    array[cell] = 0
    return recorded, tiles


def form_after(kind: ChangeKind, shift: float, form: int, shown: int) -> int | None:
    """Return the life form of a cell of `form` whose surface has moved by `shift` metres (NaN unknown); None:
    unchanged. `shown`: what a camera showed there last, UNSEEN nothing. Where plants are gone and no camera says what
    is left, it is grass: a felled stand burns."""
    if form == LifeForm.BURNED:
        return None
    if kind == ChangeKind.LOWERED:
        return LifeForm.BARE if form in (LifeForm.GRASS, LifeForm.SHRUB, LifeForm.TREE) else None
    if kind == ChangeKind.REMOVED:
        low = form == LifeForm.SHRUB and abs(shift) < SHRUB_BELOW
        if form != LifeForm.TREE and not low:
            return None
        left = (LifeForm.GRASS, LifeForm.SHRUB, LifeForm.BARE, LifeForm.BUILT)
        return shown if shown in left and shown != form else LifeForm.GRASS
    low = np.isnan(shift) or shift < SHRUB_BELOW
    if form in (LifeForm.TREE, LifeForm.BUILT) or (form == LifeForm.SHRUB and low):
        return None
    usual = LifeForm.SHRUB if low else LifeForm.TREE
    cover = shown if shown in (LifeForm.SHRUB, LifeForm.TREE, LifeForm.BUILT) else usual
    return None if cover == form else cover
