"""Draw a stratified random sample of map cells that is spread over the area.

Strata are the map's classes, split into changed and unchanged cells. Within an unchanged stratum the cells are ordered
along a Z-order curve, which is cut into equal segments with a random start; of each segment about SEGMENT random cells
are drawn. Every cell of a stratum has the same chance. Standard errors are those of a sample without segments. Shorter
segments, or segments of changed cells, whose errors are far from the true change, would make intervals too wide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import BoolArray, Int64Array, UInt8Array

FEWEST: Final = 4
"""Fewest sampled cells of a stratum that has as many."""
SEGMENT: Final = 8
"""Sampled cells of a segment."""
PLANNED_ACCURACY: Final = 0.8
"""Accuracy for which the expected half-widths are computed."""
Z95: Final = 1.959964
"""Quantile of the normal distribution for intervals of 95 %."""


@dataclass(frozen=True)
class Stratum:
    """Cells of one map class that are all changed or all unchanged; `map_class`: its id."""

    name: str
    map_class: int
    changed: bool
    cells: int
    sampled: int


@dataclass(frozen=True, eq=False)
class Sample:
    """A drawn sample. `rows`, `columns`, `stratum` (index into `strata`): (N,) each, in random order."""

    strata: tuple[Stratum, ...]
    rows: Int64Array
    columns: Int64Array
    stratum: Int64Array

    def half_widths(self) -> dict[str, float]:
        """Return the expected half-widths of 95 % intervals for a map that is right in PLANNED_ACCURACY of the cells:
        of overall accuracy, and of the user's accuracy of each stratum."""
        cells = np.array([s.cells for s in self.strata], np.float64)
        variance = np.array(
            [PLANNED_ACCURACY * (1 - PLANNED_ACCURACY) / s.sampled * (1 - s.sampled / s.cells) for s in self.strata]
        )
        weights = cells / cells.sum()
        widths = {"overall": float(Z95 * np.sqrt((weights**2 * variance).sum()))}
        return widths | {s.name: float(Z95 * np.sqrt(v)) for s, v in zip(self.strata, variance, strict=True)}


def allocated(cells: Sequence[int], changed: Sequence[bool], wanted: int) -> list[int]:
    """Return the number of sampled cells of each stratum.

    Half of the sample is divided equally between strata, where changed ones count twice; the other half goes by the
    strata's sizes. A stratum that is smaller than its share is taken whole, and the others get the rest."""
    sizes = np.asarray(cells, np.int64)
    equal = np.where(np.asarray(changed, np.bool_), 2.0, 1.0)
    shares = equal / equal.sum() + sizes / sizes.sum()
    counts = np.minimum(FEWEST, sizes)
    while counts.sum() < min(wanted, int(sizes.sum())):
        counts[np.argmin(np.where(counts < sizes, (counts + 1) / shares, np.inf))] += 1
    return [int(count) for count in counts]


def drawn(
    classes: UInt8Array, changed: BoolArray, observed: BoolArray, names: Sequence[str], wanted: int, seed: int
) -> Sample:
    """Draw about `wanted` of the `observed` cells of a map (H, W); `names`: of the classes, by id.

    Raises ConfigError if no cell was observed, or the sample has no room for the strata."""
    rng = np.random.default_rng(seed)
    keys = classes.astype(np.int64) * 2 + changed
    found, sizes = np.unique(keys[observed], return_counts=True)
    if len(found) == 0:
        raise ConfigError("the map has no observed cell; record images and update the map first")
    if wanted < min(FEWEST * len(found), int(sizes.sum())):
        raise ConfigError(f"{wanted} cells are too few for {len(found)} strata; give at least {FEWEST * len(found)}")
    counts = allocated(sizes.tolist(), (found % 2 == 1).tolist(), wanted)
    strata, places = [], []
    for key, size, count in zip(found.tolist(), sizes.tolist(), counts, strict=True):
        rows, columns = np.nonzero(observed & (keys == key))
        order = np.roll(np.argsort(z_order(rows, columns), kind="stable"), rng.integers(size))
        segments = 1 if key % 2 else max(1, count // SEGMENT)
        parts = zip(np.array_split(order, segments), np.array_split(np.arange(count), segments), strict=True)
        chosen = np.concatenate([rng.choice(cells, len(share), replace=False) for cells, share in parts])
        name = names[key // 2] + (", changed" if key % 2 else "")
        strata.append(Stratum(name, key // 2, bool(key % 2), size, count))
        places.append(np.column_stack([rows[chosen], columns[chosen], np.full(count, len(strata) - 1)]))
    every = rng.permutation(np.concatenate(places))
    return Sample(tuple(strata), every[:, 0], every[:, 1], every[:, 2])


def z_order(rows: Int64Array, columns: Int64Array) -> Int64Array:
    """Return (N,) places of cells on a Z-order curve: the bits of row and column, interleaved."""
    code = np.zeros(len(rows), np.int64)
    for bit in range(int(max(rows.max(), columns.max())).bit_length()):
        code |= ((columns >> bit) & 1) << (2 * bit) | ((rows >> bit) & 1) << (2 * bit + 1)
    return code
