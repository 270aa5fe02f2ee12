"""Draws fuel maps from what is known of each cell: what the doubt about fuel means for a fire.

The shares of life forms in a cell have a Dirichlet distribution (`docs/fuel_map.md`); a draw takes them from it, and
the cell is of the form that is the commonest in the draw. The prior's form stands for all forms that its code agrees
with. Cells beside each other are not independent, since a network mislabels stands and not cells: the draws of a form
go through a Gaussian copula, whose field is a smooth one, as wide as the context that the map uses, and an
independent one, with the measured correlation of a stand as the weight of the first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from scipy import ndimage
from scipy.special import gammaincinv, ndtr

from ltm_core.fuel.codes import FuelRegion, FuelSystem
from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.life_form import FORMS, NODATA, LifeForm, forms_of, held
from ltm_core.types import BoolArray, Float64Array, Int16Array

_USUAL_STAND: Final = 0.4
"""Correlation of two looks at cells of a stand, where none was measured."""
_RARE: Final = (LifeForm.BARE, LifeForm.WATER, LifeForm.BUILT, LifeForm.BURNED)
"""Forms that a cell is drawn to be only where a camera has shown them: a prior map errs in plants, hardly in lakes.
Were bare ground drawn wherever the prior may err, it would break up the fuel of all that nobody has seen."""
_SHOWN: Final = 1.0
"""Evidence from which on a form counts as shown."""


@dataclass(frozen=True, eq=False)
class CellDoubt:
    """What is known of each cell. `alpha`: (H, W, FORMS) of the Dirichlet distribution of its life forms, prior and
    evidence together. `prior`, `code`: (H, W) fuel codes before and now. `fixed`: (H, W) cells that no draw changes.
    """

    alpha: Float64Array
    prior: Int16Array
    code: Int16Array
    fixed: BoolArray

    @classmethod
    def of(cls, layers: FuelLayers, alpha: Float64Array, mask: tuple[int, ...]) -> CellDoubt:
        """`mask`: codes that labels never change (`FusionRules.mask`)."""
        fixed = held(layers.prior, mask) | (layers.code == NODATA)
        return cls(alpha, layers.prior, layers.code, fixed)


def drawn_codes(
    doubt: CellDoubt,
    region: FuelRegion,
    system: FuelSystem,
    rng: np.random.Generator,
    width: float = 3.0,
    stand: float | None = None,
) -> Int16Array:
    """(H, W) the codes of one draw. `width`: cells, of the smooth field; `stand`: its share of the variance."""
    shared = _USUAL_STAND if stand is None else stand
    agreeing = forms_of(doubt.prior)
    prior = np.where(agreeing, doubt.alpha, 0.0).sum(axis=-1)
    has_prior = agreeing.any(axis=-1)
    best = np.where(has_prior, _gamma(prior, rng, width, shared), -1.0)
    form = np.full(doubt.prior.shape, -1)
    for k in range(FORMS):
        alpha = np.where(agreeing[..., k] & has_prior, 0.0, doubt.alpha[..., k])
        if LifeForm(k + 1) in _RARE:
            alpha = np.where(alpha >= _SHOWN, alpha, 0.0)
        drawn = _gamma(alpha, rng, width, shared)
        larger = (alpha > 0) & (drawn > best)
        best, form = np.where(larger, drawn, best), np.where(larger, k, form)
    over_shrubs = agreeing[..., LifeForm.SHRUB - 1]
    codes = np.where(form < 0, doubt.prior, getattr(region.changed, system).of(form, over_shrubs))
    # Where the draw is of what the map says anyway, its own code of that form: a mixture, or what grew after a burn.
    own = forms_of(doubt.code)
    rows, cols = np.indices(form.shape)
    same = (form >= 0) & own[rows, cols, np.maximum(form, 0)]
    codes = np.where(same | doubt.fixed, doubt.code, codes)
    return codes.astype(np.int16)


def with_codes(layers: FuelLayers, codes: Int16Array) -> FuelLayers:
    """The layers with other codes, which are changes where they are not the prior's."""
    return replace(layers, code=codes, changed=codes != layers.prior)


def _gamma(alpha: Float64Array, rng: np.random.Generator, width: float, shared: float) -> Float64Array:
    """(H, W) gamma variates of shapes `alpha`, correlated between neighbours; 0 where the shape is 0."""
    smooth = ndimage.gaussian_filter(rng.standard_normal(alpha.shape), width, mode="wrap")
    smooth /= _smoothed_deviation(alpha.shape, width)
    field = np.sqrt(shared) * smooth + np.sqrt(1 - shared) * rng.standard_normal(alpha.shape)
    share = np.clip(ndtr(field), 1e-9, 1 - 1e-9)
    result = np.zeros(alpha.shape)
    some = alpha > 0
    result[some] = gammaincinv(alpha[some], share[some])
    return result


@lru_cache(maxsize=4)
def _smoothed_deviation(shape: tuple[int, ...], width: float) -> float:
    """What the filter leaves of a deviation of 1: its weights, squared and summed, are the variance that is left."""
    impulse = np.zeros(shape)
    impulse[0, 0] = 1.0
    return float(np.sqrt((ndimage.gaussian_filter(impulse, width, mode="wrap") ** 2).sum()))
