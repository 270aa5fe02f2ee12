"""Compute the figures of an accuracy assessment from a plan and the interpreters' answers."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.assessment.estimation import Accuracy, Estimate, StratifiedSample, assessed, joined, kappa
from ltm_core.base.errors import ConfigError
from ltm_core.base.types import BoolArray, Int64Array, UInt8Array
from ltm_core.fuel.class_map import UNSEEN
from ltm_core.fuel.life_form import NODATA
from ltm_ros.assessment.answers_io import Answer, SampledCell, read_answers, read_field_plots
from ltm_ros.assessment.plan import NAMES, MapPlan, agrees_with_prior


@dataclass(frozen=True)
class Agreement:
    """Agreement of another interpreter with the first, over the cells that both answered."""

    name: str
    cells: int
    share: float
    kappa: float


@dataclass(frozen=True, eq=False)
class Figures:
    """Figures of a plan. `classes`: ids of the life forms that occur. `cells`: those that count; `mapped`, `reference`:
    (N,) their life forms. `changes`: Estimates by name; empty without a prior map. `unanswered`, `hidden`, `learned`:
    numbers of cells without an answer, that cannot be seen, and that the network learned from; these do not count."""

    interpreter: str
    classes: tuple[int, ...]
    cells: tuple[SampledCell, ...]
    mapped: UInt8Array
    reference: UInt8Array
    sample: StratifiedSample
    map: Accuracy
    prior: Accuracy | None
    changes: dict[str, Estimate]
    agreements: tuple[Agreement, ...]
    unanswered: int
    hidden: int
    learned: int
    unsure: int
    plots: int

    @property
    def right(self) -> BoolArray:
        """Return (N,) whether the map is right in the cells that count."""
        return np.asarray(self.mapped == self.reference, np.bool_)

    def as_json(self, plan: MapPlan) -> dict[str, Any]:
        """Return the figures for `report.json`; areas in hectares."""
        hectares = sum(stratum.cells for stratum in plan.strata) * plan.shown.cell_m**2 / 1e4
        names = [NAMES[k] for k in self.classes]

        def of(accuracy: Accuracy) -> dict[str, Any]:
            return {
                "overall": asdict(accuracy.overall),
                "error_matrix": {"rows_map_columns_reference": names, "share": accuracy.matrix.tolist()},
                "sampled_cells": accuracy.counts.tolist(),
                "users": {n: asdict(e) for n, e in zip(names, accuracy.users, strict=True)},
                "producers": {n: asdict(e) for n, e in zip(names, accuracy.producers, strict=True)},
                "hectares": {n: asdict(e.times(hectares)) for n, e in zip(names, accuracy.area, strict=True)},
            }

        return {
            "plan": plan.about,
            "interpreter": self.interpreter,
            "cells": len(self.cells),
            "unanswered": self.unanswered,
            "cannot_be_seen": self.hidden,
            "used_for_learning": self.learned,
            "unsure": self.unsure,
            "field_plots": self.plots,
            "map": of(self.map),
            "prior_map": None if self.prior is None else of(self.prior),
            "change": {name: asdict(estimate) for name, estimate in self.changes.items()},
            "other_interpreters": [asdict(agreement) for agreement in self.agreements],
        }

    def line(self, plan: MapPlan) -> str:
        """Return the overall accuracy in one line, for the tags of exports."""
        overall = self.map.overall
        return (
            f"overall accuracy {100 * overall.value:.1f} % (95 % interval {100 * overall.low:.1f} to "
            f"{100 * overall.high:.1f} %), stratified sample of {len(self.cells)} observed cells, map as of "
            f"{plan.about['map']['as_of']}"
        )


def compute_figures(plan: MapPlan, plots: Path | None) -> Figures:
    """Compute the figures from the answers of the interpreter with most of them, and from field plots, which replace
    answers. Raises ConfigError without answers."""
    read = {name: read_answers(plan.shown.answers_file(name)) for name in plan.shown.interpreters()}
    given = {name: {answer.cell: answer for answer in answers} for name, answers in read.items()}
    first = max(given, key=lambda name: len(given[name]), default="")
    visited = {} if plots is None else {answer.cell: answer for answer in read_field_plots(plots, plan.shown)}
    answers = given.get(first, {}) | visited
    learned = plan.shown.learned()
    counted = [
        (cell, answer)
        for cell in plan.shown.cells
        if (answer := answers.get(cell.cell)) is not None and answer.life_form and cell.cell not in learned
    ]
    if len(counted) < 2:
        raise ConfigError(
            f"{plan.shown.folder}: has {len(counted)} answers that count; answer the cells with `ltm assess look`"
        )
    rows, columns = (np.array([getattr(cell, name) for cell, _ in counted]) for name in ("row", "column"))
    reference = np.array([NAMES.index(answer.life_form) for _, answer in counted], np.uint8)
    stratum = np.array([plan.stratum[cell.cell] for cell, _ in counted])
    sample = joined(stratum, [s.cells for s in plan.strata])
    mapped, before = plan.map.life_form[rows, columns], plan.map.prior_form[rows, columns]
    has_prior = before != UNSEEN
    classes = tuple(np.unique(np.concatenate([mapped, reference, before[has_prior]])).tolist())
    place = {form: k for k, form in enumerate(classes)} | {UNSEEN: 0}
    codes, of_map, of_prior = (np.array([place[int(v)] for v in form]) for form in (reference, mapped, before))
    within = {cell.cell for cell in plan.shown.cells}
    hidden = sum(a.certainty == "cannot_be_seen" for cell, a in answers.items() if cell in within)
    return Figures(
        first or "field plots",
        classes,
        tuple(cell for cell, _ in counted),
        mapped,
        reference,
        sample,
        assessed(sample, of_map, codes, len(classes)),
        assessed(sample, of_prior, codes, len(classes)) if has_prior.all() else None,
        _changes(plan, sample, rows, columns, reference),
        tuple(_agreements(first, given)),
        len(within - answers.keys()),
        hidden,
        len(learned & answers.keys()),
        sum(answer.certainty == "unsure" for _, answer in counted),
        len(visited),
    )


def _changes(
    plan: MapPlan, sample: StratifiedSample, rows: Int64Array, columns: Int64Array, reference: UInt8Array
) -> dict[str, Estimate]:
    """Return the figures of change: a cell has changed if its life form is none of those of its prior code."""
    prior = plan.map.prior[rows, columns]
    known = prior != NODATA
    if not known.any():
        return {}
    flagged = plan.map.changed[rows, columns]
    true = known & ~agrees_with_prior(np.where(known, prior, 0).astype(np.int16), reference)
    return {
        "prevalence": sample.ratio(true, known, "whole"),
        "mapped": replace(sample.ratio(flagged, known, "part"), error=0.0),
        "users": sample.ratio(true, flagged, "whole"),
        "producers": sample.ratio(flagged, true, "part"),
    }


def _agreements(first: str, given: dict[str, dict[int, Answer]]) -> list[Agreement]:
    found = []
    for name, answers in given.items():
        both = [c for c, a in answers.items() if name != first and a.life_form and c in given[first]]
        pairs = [(given[first][c].life_form, answers[c].life_form) for c in both if given[first][c].life_form]
        if pairs:
            one, other = (np.array([NAMES.index(form) for form in side]) for side in zip(*pairs, strict=True))
            found.append(Agreement(name, len(pairs), *kappa(one, other, len(NAMES))))
    return found
