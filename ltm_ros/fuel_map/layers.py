"""Hold the life form and fuel code of each cell as of the last refresh, for display and for the journal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import Int16Array, UInt8Array
from ltm_core.fuel.evidence import EvidenceMap, Window
from ltm_core.pipeline.stored_fuel import JOURNALED
from ltm_core.storage.tile_store import TileStore
from ltm_core.storage.tile_store_schema import CellChanges


class ShownLayers:
    """Life form and code as of the last refresh, (H, W) each; computing them for every frame would cost too much."""

    def __init__(self, evidence: EvidenceMap) -> None:
        self._evidence = evidence
        layers = evidence.layers()
        self.life_form: UInt8Array = layers.life_form
        self.code: Int16Array = layers.code
        self._seen, self._changed = layers.evidence > 0, layers.changed.copy()

    @property
    def seen_cells(self) -> int:
        """Return the number of cells with evidence."""
        return int(self._seen.sum())

    @property
    def changed_cells(self) -> int:
        """Return the number of cells whose code differs from the prior."""
        return int(self._changed.sum())

    def tells(self, window: Window) -> bool:
        """Return whether a part of the map has evidence, or had some at the last refresh."""
        row, col, height, width = window
        part = slice(row, row + height), slice(col, col + width)
        return bool(self._seen[part].any() or self._changed[part].any())

    def refresh(self, windows: Sequence[Window]) -> list[CellChanges]:
        """Recompute these parts of the map; return what has changed."""
        return [change for window in _merged(windows) for change in self._refresh(window)]

    def refresh_all(self) -> list[CellChanges]:
        """Recompute everything, because time alone changes cells: evidence decays, and vegetation grows
        back on burns.
        """
        return self.refresh([(0, 0, *self._evidence.geometry.shape)])

    def missing_from(self, journal: TileStore, initial: Mapping[str, NDArray[Any]]) -> list[CellChanges]:
        """Return how the layers differ from the `initial` ones (without evidence) with the journal applied.

        The differences are stamped one nanosecond after the latest frame, so that the map as of that frame stays as it
        was shown.
        """
        found = []
        for name in JOURNALED:
            recorded = journal.as_of(name, initial[name], 2**63 - 1)
            found += self._changes(name, recorded, getattr(self, name), (0, 0), self._evidence.newest_ns + 1)
        return found

    def copies(self) -> dict[str, NDArray[Any]]:
        return {name: getattr(self, name).copy() for name in JOURNALED}

    def _refresh(self, window: Window) -> list[CellChanges]:
        row, col, height, width = window
        part = slice(row, row + height), slice(col, col + width)
        layers = self._evidence.layers(window)
        found = []
        for name in JOURNALED:
            shown, now = getattr(self, name)[part], getattr(layers, name)
            found += self._changes(name, shown, now, (row, col), self._evidence.newest_ns)
            shown[...] = now
        self._seen[part], self._changed[part] = layers.evidence > 0, layers.changed
        return found

    def _changes(
        self, layer: str, old: NDArray[Any], new: NDArray[Any], corner: tuple[int, int], stamp: int
    ) -> list[CellChanges]:
        rows, cols = np.nonzero(old != new)
        if len(rows) == 0:
            return []
        return [CellChanges(layer, stamp, rows + corner[0], cols + corner[1], old[rows, cols], new[rows, cols])]


def _merged(windows: Sequence[Window]) -> list[Window]:
    """Return one window over all, unless they are so far apart that it would be larger than their sum."""
    if len(windows) < 2:
        return list(windows)
    row, col = min(w[0] for w in windows), min(w[1] for w in windows)
    height, width = max(w[0] + w[2] for w in windows) - row, max(w[1] + w[3] for w in windows) - col
    if height * width <= sum(w[2] * w[3] for w in windows):
        return [(row, col, height, width)]
    return list(windows)
