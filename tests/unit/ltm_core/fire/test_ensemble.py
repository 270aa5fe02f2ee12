from __future__ import annotations

import numpy as np
import pytest

from ltm_core.fire.effect import CellDoubt, drawn_codes
from ltm_core.fuel.codes import FuelClimate, FuelSystem
from ltm_core.fuel.decision import layers_of_classes
from ltm_core.fuel.life_form import FORMS, LifeForm
from ltm_core.fuel.prior import FuelPrior
from ltm_core.geometry.grid import GridGeometry

SHAPE = (30, 41)
CLIMATE = FuelClimate.named("dry")
MASK = (91, 92, 93, 98, 99)


def doubt(prior: int, code: int, **evidence: float) -> CellDoubt:
    """Of cells that are all alike; `evidence` of forms by name."""
    alpha = np.full((*SHAPE, FORMS), 0.05)
    for name, value in evidence.items():
        alpha[..., LifeForm[name.upper()] - 1] = value
    codes = np.full(SHAPE, prior, np.int16)
    return CellDoubt(alpha, codes, np.full(SHAPE, code, np.int16), np.isin(codes, MASK))


def draws(of: CellDoubt, count: int = 40, stand: float = 0.4) -> np.ndarray:
    return np.stack(
        [drawn_codes(of, CLIMATE, FuelSystem.FBFM40, np.random.default_rng([7, k]), 3.0, stand) for k in range(count)]
    )


@pytest.mark.parametrize(("grass", "tree"), [(8.0, 2.0), (2.0, 8.0), (30.0, 1.0)])
def test_shares_are_those_of_the_dirichlet(grass: float, tree: float) -> None:
    from scipy.special import betainc

    alike = draws(doubt(102, 102, grass=grass, tree=tree, shrub=0.001, bare=0.001))
    assert (alike == 102).mean() == pytest.approx(1 - betainc(grass, tree, 0.5), abs=0.04)


def test_neighbours_are_drawn_alike_as_far_as_the_stand_says() -> None:
    def likeness(stand: float) -> float:
        trees = (draws(doubt(102, 102, grass=4.0, tree=4.0), 40, stand) == 183).astype(float)
        a, b = trees[:, :, :-1].ravel(), trees[:, :, 1:].ravel()
        return float(np.corrcoef(a, b)[0, 1])

    none, half, much = likeness(0.0), likeness(0.4), likeness(0.9)
    assert abs(none) < 0.03
    assert 0.1 < half < much


def test_what_is_known_or_masked_stays() -> None:
    assert (draws(doubt(98, 98, tree=50.0), 5) == 98).all()
    assert (draws(doubt(147, 147, shrub=400.0), 5) == 147).all()
    # A map errs in plants: no lake where no camera has shown one.
    assert 98 not in draws(doubt(102, 102, grass=0.5, water=0.9), 20)
    assert 98 in draws(doubt(102, 102, grass=2.0, water=4.0), 20)
    assert 99 not in draws(doubt(102, 102, grass=0.5, bare=0.9), 20)


def test_a_changed_cell_keeps_its_own_code_of_a_form_or_goes_back_to_the_priors() -> None:
    found = draws(doubt(147, 165, shrub=3.0, tree=6.0))
    assert set(np.unique(found).tolist()) <= {147, 165, 102, 99}
    assert (found == 165).mean() > (found == 147).mean() > 0.05
    grown = draws(doubt(183, 121, tree=2.0, grass=9.0))
    assert 121 in grown
    assert 102 not in grown


def test_no_draw_changes_a_code_of_no_known_form() -> None:
    codes = np.full((3, 4), 102, np.int16)
    codes[1] = (256, 20, 98, 102)
    prior = FuelPrior(codes, GridGeometry(0.0, 90.0, 30.0, 4, 3, "EPSG:32611"))
    layers = layers_of_classes(np.full((3, 4), LifeForm.TREE, np.uint8), prior, CLIMATE)
    np.testing.assert_array_equal(layers.code[1], (256, 20, 98, 183))
    doubts = CellDoubt.of(layers, np.full((3, 4, FORMS), 2.0), MASK)
    for seed in range(20):
        drawn = drawn_codes(doubts, CLIMATE, FuelSystem.FBFM40, np.random.default_rng(seed))
        np.testing.assert_array_equal(drawn[1, :3], (256, 20, 98))
