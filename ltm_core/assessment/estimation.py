"""Estimate accuracies and areas from a stratified random sample, with standard errors and 95 % intervals.

Strata are the map's classes, split into changed and unchanged cells. Within an unchanged stratum the cells are ordered
along a Z-order curve and cut into equal segments; of each about SEGMENT random cells are drawn. Shorter segments, or
segments of changed cells, whose errors are far from the true change, would make intervals too wide.

Every figure is a share of cells that have one property among those that have another. Estimates and standard errors
are those of Stehman (2014, Int. J. Remote Sens. 35), which for strata equal to map classes are those of Olofsson et al.
(2014, Remote Sens. Environ. 148), with the correction for finite populations. Intervals count half a success and half a
failure more (Jeffreys' prior), each in the stratum in which a cell weighs most. They are quantiles of the beta
distribution (as Korn and Graubard 1998, Surv. Methodol. 24) with the mean and variance of the share after all other
cells are drawn from Dirichlet distributions. `ltm-lab eval assessment` counts how many intervals contain the truth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import ArrayLike

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import BoolArray, Float64Array, Int64Array, UInt8Array

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
    """Return the number of sampled cells of each stratum. Half of the sample is divided equally between strata, where
    changed ones count twice; the other half goes by the strata's sizes. A stratum that is smaller than its share is
    taken whole, and the others get the rest."""
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
    """Draw about `wanted` of the `observed` cells of a map (H, W); `names`: of the classes, by id. Raises ConfigError
    if no cell was observed, or the sample has no room for the strata."""
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


FEWEST_EVENTS: Final = 7.0
"""Events below which an interval is approximate: their number takes so few values that coverage jumps with the true
share. That of the mid-P interval of Poisson counts leaves 93 to 97 % up to 6.6 expected events."""


@dataclass(frozen=True)
class Estimate:
    """A share with its standard error and 95 % interval; `cells`: sampled cells that it rests on. NaN if there are
    none. `events`: effective number of sampled cells with the rarer outcome, such as errors of a good map."""

    value: float
    error: float
    low: float
    high: float
    cells: int
    events: float

    @property
    def approximate(self) -> bool:
        """Return whether the interval rests on too few events to contain the truth in 93 to 97 % of the samples."""
        return self.low < self.high and self.events < FEWEST_EVENTS

    def times(self, factor: float) -> "Estimate":
        """Return the estimate in another unit, such as hectares."""
        scaled = {name: factor * getattr(self, name) for name in ("value", "error", "low", "high")}
        return replace(self, **scaled)


@dataclass(frozen=True, eq=False)
class StratifiedSample:
    """The answered cells of a sample. `stratum`: (N,) index of each cell's stratum. `sizes`: (H,) cells of each stratum
    in the map; strata without answered cells have been joined with others (`joined`)."""

    stratum: Int64Array
    sizes: Int64Array

    def ratio(self, part: ArrayLike, whole: ArrayLike, of_map: str) -> Estimate:
        """Return the share of the cells in `whole` that are in `part` too, (N,) bool each. `of_map`: "part" or "whole",
        whichever the map alone decides, so that its value varies only among the values observed in a stratum. The other
        one is the reference's."""
        shown, inside = np.asarray(part, np.bool_), np.asarray(whole, np.bool_)
        if not inside.any():
            return Estimate(np.nan, np.nan, np.nan, np.nan, 0, 0.0)
        hit = shown & inside
        counts = self._totals(np.ones(len(hit)))
        total = float(self.sizes @ (self._totals(inside) / counts))
        share = float(self.sizes @ (self._totals(hit) / counts)) / total
        residual = hit - share * inside
        deviation = np.round(residual - (self._totals(residual) / counts)[self.stratum], 12)
        spread = self._totals(deviation**2) / np.maximum(counts - 1, 1)
        unsampled = 1 - counts / self.sizes
        error = float(np.sqrt((self.sizes**2.0 * spread / counts * unsampled).sum())) / total
        # The inverse square of a skewness in which no two errors cancel: n equal weights of rare outcomes give n.
        weighed = (self.sizes / counts)[self.stratum] * np.abs(deviation)
        second, third = (float(unsampled[self.stratum] @ weighed**power) for power in (2, 3))
        events = second**3 / third**2 if third else 0.0
        known = inside if of_map == "whole" else shown
        low, high = self._interval(hit, inside & ~shown, known, known if of_map == "whole" else ~known)
        return Estimate(share, error, min(low, share), max(high, share), int(inside.sum()), events)

    def _totals(self, values: BoolArray | Float64Array) -> Float64Array:
        """Return the sum of values, (N,), of each stratum."""
        return np.bincount(self.stratum, values, len(self.sizes)).astype(np.float64)

    def _interval(
        self, hit: BoolArray, miss: BoolArray, may_hit: BoolArray, may_miss: BoolArray
    ) -> tuple[float, float]:
        """Return the 2.5 % and 97.5 % quantiles of the share of hits. `may_hit`, `may_miss`: cells whose strata can
        have hits or misses among the unsampled cells."""
        sampled, hits, misses = (self._totals(cells) for cells in (np.ones(len(hit)), hit, miss))
        rest, cells = self.sizes - sampled, sampled.copy()
        for found, possible in ((hits, may_hit), (misses, may_miss)):
            if possible.any():
                heaviest = np.argmax(np.where(self._totals(possible) > 0, self.sizes * rest / sampled**2, -1.0))
                found[heaviest] += 0.5
                cells[heaviest] += 0.5
        p, q = hits / cells, misses / cells
        of_hits, of_misses = float(hit.sum() + rest @ p), float(miss.sum() + rest @ q)
        total = of_hits + of_misses
        share = of_hits / total
        spread = p * (1 - share) ** 2 + q * share**2 - (p * (1 - share) - q * share) ** 2
        variance = float((rest * spread * (cells + rest) / (cells + 1)).sum()) / total**2
        if variance <= 0:  # all cells were answered, or the map alone decides
            return share, share
        size = max(share * (1 - share) / variance - 1, 1e-3)
        low, high = scipy.special.betaincinv(size * share, size * (1 - share), (0.025, 0.975))
        return float(low), float(high)


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Accuracies and areas of a map. `matrix`: (K, K) shares of the area, rows map, columns reference. `users`,
    `producers`, `area`: by class; `area` and `mapped` as shares."""

    matrix: Float64Array
    counts: Int64Array
    overall: Estimate
    users: tuple[Estimate, ...]
    producers: tuple[Estimate, ...]
    area: tuple[Estimate, ...]
    mapped: Float64Array


def assessed(sample: StratifiedSample, mapped: Int64Array, reference: Int64Array, classes: int) -> Accuracy:
    """Return the accuracy of a map; `mapped`, `reference`: (N,) indices of the classes of the sampled cells."""
    every = np.ones(len(mapped), np.bool_)
    counts = np.bincount(sample.stratum, minlength=len(sample.sizes))
    weights = (sample.sizes / counts)[sample.stratum] / sample.sizes.sum()
    cells = mapped * classes + reference
    matrix = np.bincount(cells, weights, classes**2).reshape(classes, classes).astype(np.float64)
    kinds = range(classes)
    return Accuracy(
        matrix,
        np.bincount(cells, minlength=classes**2).reshape(classes, classes),
        sample.ratio(mapped == reference, every, "whole"),
        tuple(sample.ratio(reference == k, mapped == k, "whole") for k in kinds),
        tuple(sample.ratio(mapped == k, reference == k, "part") for k in kinds),
        tuple(sample.ratio(reference == k, every, "whole") for k in kinds),
        matrix.sum(axis=1),
    )


def joined(stratum: Int64Array, sizes: ArrayLike) -> StratifiedSample:
    """Return the sample of the answered cells, (N,), among strata of `sizes` cells (H,). A stratum with fewer than two
    answered cells, unless all its cells were answered, is joined with its smallest neighbour in order of strata."""
    each = np.asarray(sizes, np.int64)
    group = np.arange(len(each))
    while True:
        cells = np.bincount(group, each).astype(np.int64)
        lacking = np.flatnonzero(np.bincount(group[stratum], minlength=len(cells)) < np.minimum(2, cells))
        if len(cells) == 1 or len(lacking) == 0:
            return StratifiedSample(group[stratum], cells)
        beside = [g for g in (lacking[0] - 1, lacking[0] + 1) if 0 <= g < len(cells)]
        other = min(beside, key=lambda g: int(cells[g]))
        group[group >= max(lacking[0], other)] -= 1


def kappa(first: Int64Array, second: Int64Array, classes: int) -> tuple[float, float]:
    """Return agreement and Cohen's kappa of two interpreters' classes, (N,) each, of at least one cell."""
    table = np.bincount(first * classes + second, minlength=classes**2).reshape(classes, classes) / len(first)
    agreed = float(np.trace(table))
    chance = float(table.sum(axis=0) @ table.sum(axis=1))
    return agreed, (agreed - chance) / (1 - chance) if chance < 1 else 1.0
