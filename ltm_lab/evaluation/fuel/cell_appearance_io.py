"""`ltm-lab train appearance`: fits cell appearance on simulated sites, tests it on held-out sites, and writes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from ltm_core.base.errors import ConfigError
from ltm_core.fuel.cell_appearance_model import CellAppearanceFile, CellAppearanceModel
from ltm_core.fuel.label_errors import LabelCorrelation
from ltm_core.fuel.life_form import FORMS, LifeForm, label_forms
from ltm_core.fuel.rules import FusionRules
from ltm_core.vision.labels import LabelSet
from ltm_lab.evaluation.fuel.cell_appearance_fit import fit_cell_appearance, seen_cells
from ltm_lab.evaluation.fuel.label_correlation import look_correlation, looks
from ltm_lab.evaluation.fuel.simulated_votes import SimulatedVotes

_HEAD = """\
# Appearance of the fuel cells of each life form to this network, and the correlation of its errors (docs/how/fuel.md).
# appearance: weights of a constant, of the label shares of the cell (grass, shrub, tree, bare, water, built, burned),
# of these shares times the labels' confidence over 0.7, of the cell in front and of the cell behind; one row for each
# incidence.
# correlation: what two cells of a stand, two frames of a view, and two views have in common beyond their life form,
# on sites that were not used to learn the appearance.
"""


@dataclass(frozen=True, eq=False)
class LearntLook:
    """`appearance`: of all sites. `correlation`: on each site, of looks learnt on the others. `right`: of each form,
    its id, the share of its cells in frames told rightly so, and by most of their labels.
    """

    appearance: CellAppearanceModel
    correlation: LabelCorrelation
    right: list[tuple[int, float, float]]


def learn_cell_appearance(sites: Sequence[SimulatedVotes], labels: LabelSet) -> LearntLook:
    """Raises ConfigError for fewer than two sites, ImageError for too few cells."""
    if len(sites) < 2:
        raise ConfigError(
            "the looks of cells are learnt from two sites or more: each is tried on one that taught nothing"
        )
    forms = label_forms(labels)
    cells = [seen_cells(site.votes, site.truth, forms) for site in sites]
    tried, told = [], np.zeros((3, FORMS))
    for index, site in enumerate(sites):
        of_others = fit_cell_appearance(cells[:index] + cells[index + 1 :])
        tried.append((looks(site.votes, site.truth, forms, of_others), site.truth.shape))
        own = cells[index]
        guess = of_others.log_likelihood(own.seen, own.cosine).argmax(axis=1)
        most = own.seen[:, 1 : 1 + FORMS].argmax(axis=1)
        for row, chosen in enumerate((np.ones(len(own.true), bool), guess == own.true, most == own.true)):
            told[row] += np.bincount(own.true[chosen], minlength=FORMS)
    right = [
        (form.value, float(told[1, form - 1] / cells_of), float(told[2, form - 1] / cells_of))
        for form in LifeForm
        if (cells_of := told[0, form - 1]) > 0
    ]
    return LearntLook(fit_cell_appearance(cells), look_correlation(tried, FusionRules().context_cells), right)


def write_cell_appearance(file: Path, learnt: LearntLook, source: str) -> None:
    """As a file of `LabelErrors`. Raises ConfigError where it cannot be written."""
    model = learnt.appearance
    known = {form.name.lower(): model.weights[form - 1] for form in LifeForm if model.known[form - 1]}
    appearance = CellAppearanceFile(
        incidence=model.incidence.tolist(),
        weights={name: np.round(rows, 2).tolist() for name, rows in known.items()},
    )
    content = {
        "source": source,
        "correlation": learnt.correlation.model_dump(),
        "appearance": appearance.model_dump(),
    }
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=118)
    try:
        file.write_text(_HEAD + text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{file}: cannot be written ({error.strerror})") from error
