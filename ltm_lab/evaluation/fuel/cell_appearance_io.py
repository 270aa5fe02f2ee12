"""`ltm-lab train appearance`: fits cell appearance on simulated sites and tests it on held-out sites."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import ConfigError
from ltm_core.fuel.cell_appearance_model import CellAppearanceModel
from ltm_core.fuel.label_errors import LabelCorrelation
from ltm_core.fuel.label_measurement import fit_cell_appearance, look_correlation, looks, seen_cells
from ltm_core.fuel.life_form import FORMS, LifeForm, label_forms
from ltm_core.fuel.rules import FusionRules
from ltm_core.vision.labels import LabelSet
from ltm_lab.evaluation.fuel.simulated_votes import SimulatedVotes


@dataclass(frozen=True, eq=False)
class LearntLook:
    """`appearance`: of all sites. `correlation`: on each site, of looks learnt on the others. `right`: of each form,
    its id, the share of its cells in frames told rightly so, and by most of their labels."""

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
