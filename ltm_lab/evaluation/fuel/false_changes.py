"""What the changes that a fuel map reports falsely are: region by region, what cameras said of them, and which."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ltm_core.base.types import BoolArray, Float64Array, Int64Array, UInt8Array
from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.life_form import FORMS, LifeForm, form_counts
from ltm_core.fuel.votes import CellVotes
from ltm_core.scoring.fuel_change import held_forms


@dataclass(frozen=True, eq=False)
class FalseRegion:
    """Cells that lie beside each other, whose true life form is the prior's, and which the map has changed.

    `true`, `mapped`: their commonest forms. `labels`: (FORMS,) shares of the pixels that voted in them. `cameras`: that
    saw them, by name. `footprint`: metres of ground that a pixel covers, the least of all frames, median of the cells;
    NaN where no frame tells. `beside_change`: whether they touch a cell that has truly changed.
    """

    cells: int
    row: int
    col: int
    true: LifeForm
    mapped: LifeForm
    labels: Float64Array
    cameras: tuple[str, ...]
    footprint: float
    beside_change: bool

    @property
    def labelled_right(self) -> bool:
        """Whether most pixels were of the true form: not the network has erred, but the map."""
        return int(np.argmax(self.labels)) == self.true - 1


def false_regions(
    layers: FuelLayers, truth: UInt8Array, frames: Sequence[CellVotes], forms: Int64Array
) -> list[FalseRegion]:
    """The largest first. `truth`: (H, W) true life forms; cells without one, and those that no frame saw, are left out.
    `forms`: of labels, as of `label_forms`."""
    shape = truth.shape
    counts, footprint = np.zeros((*shape, FORMS)), np.full(shape, np.nan)
    seen_by: dict[str, BoolArray] = {}
    for frame in frames:
        cells = frame.rows, frame.cols
        counts[cells] += form_counts(frame.counts, forms)
        seen_by.setdefault(frame.source, np.zeros(shape, np.bool_))[cells] = True
        if frame.visibility is not None:
            footprint[cells] = np.fmin(footprint[cells], frame.visibility.footprint)
    known = (truth >= 1) & (truth <= FORMS) & (counts.sum(axis=2) > 0)
    held = np.zeros(shape, np.bool_)
    held[known] = held_forms(layers.prior[known], truth[known])
    near_change = ndimage.binary_dilation(known & ~held, np.ones((3, 3)))
    regions, count = ndimage.label(known & held & layers.changed, np.ones((3, 3)))
    found = []
    for number in range(1, count + 1):
        region = regions == number
        pixels = counts[region].sum(axis=0)
        told = footprint[region & ~np.isnan(footprint)]
        row, col = np.argwhere(region).mean(axis=0).astype(int).tolist()
        found.append(
            FalseRegion(
                int(region.sum()),
                row,
                col,
                _commonest(truth[region]),
                _commonest(layers.life_form[region]),
                pixels / pixels.sum(),
                tuple(sorted(name for name, seen in seen_by.items() if seen[region].any())),
                float(np.median(told)) if told.size else float("nan"),
                bool((region & near_change).any()),
            )
        )
    return sorted(found, key=lambda one: (-one.cells, one.row, one.col))


def _commonest(forms: UInt8Array) -> LifeForm:
    return LifeForm(int(np.bincount(forms).argmax()))
