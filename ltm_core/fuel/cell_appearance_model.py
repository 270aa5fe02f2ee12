"""Likelihood of the labels that a frame shows in a fuel cell, for each life form that the cell may have.

A pixel shows the first plant on its ray, which is counted where the ray meets bare terrain behind it. Tall plants
therefore fill a larger share of a cell's pixels than of its ground, and of the pixels of cells behind it too. How large
depends on the angle of sight and on the neighbours along it. `CellAppearanceModel` is a logistic regression with as
many cells of each form, which gives the log ratios of the likelihoods of what is seen (Qin, Biometrika 85, 1998).
`ltm-lab train appearance` fits it."""

from functools import cached_property
from itertools import pairwise
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import BoolArray, Float64Array, Int64Array
from ltm_core.fuel.life_form import FORMS, LifeForm

SEEN: Final = 1 + 4 * FORMS
"""Features: a constant, the label shares in the cell, these times the confidence of the labels, and the shares in the
cells in front of it and behind it."""
USUAL: Final = 0.7
"""Reference confidence of labels, and the confidence of labels that have none."""
_NAMES: Final = tuple(form.name.lower() for form in LifeForm)


class CellAppearanceModel(StrictModel):
    """Model of a cell's label features by life form. `incidence`: (K,) increasing cosines of the angle between line of
    sight and ground normal. `weights`: for each form on which the network was tested, at each incidence, of the
    features (`SEEN`); interpolated linearly."""

    incidence: tuple[float, ...] = Field(min_length=2)
    weights: dict[str, tuple[tuple[float, ...], ...]]

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if any(b <= a for a, b in pairwise(self.incidence)):
            raise ValueError(f"incidence must increase, got {self.incidence}")
        if len(self.weights) < 2 or not set(self.weights) <= set(_NAMES):
            raise ValueError(f"weights must be of two or more of {', '.join(_NAMES)}; got {', '.join(self.weights)}")
        for form, rows in self.weights.items():
            if len(rows) != len(self.incidence) or any(len(row) != SEEN for row in rows):
                raise ValueError(f"weights.{form}: must be {len(self.incidence)} rows of {SEEN}")
        return self

    def rounded(self) -> "CellAppearanceModel":
        """Return a copy with two digits, for a file."""
        weights = {form: tuple(map(tuple, np.round(rows, 2).tolist())) for form, rows in self.weights.items()}
        return CellAppearanceModel(incidence=self.incidence, weights=weights)

    @cached_property
    def known(self) -> BoolArray:
        """Return (FORMS,) whether the network was tested on a form."""
        return np.array([name in self.weights for name in _NAMES])

    def log_likelihood(self, seen: Float64Array, cosine: Float64Array) -> Float64Array:
        """Return (N, FORMS) log likelihood of the features (N, SEEN), up to a constant for each cell; -inf for unknown
        forms."""
        inputs = at_incidence(seen, cosine, np.array(self.incidence))
        result = np.full((len(seen), FORMS), -np.inf)
        result[:, self.known] = inputs @ self._table
        return result

    @cached_property
    def _table(self) -> Float64Array:
        return np.array([np.ravel(self.weights[name]) for name in _NAMES if name in self.weights]).T


def what_is_seen(
    rows: Int64Array,
    cols: Int64Array,
    shares: Float64Array,
    bearing: NDArray[np.floating],
    confidence: NDArray[np.floating] | None,
) -> Float64Array:
    """Return (N, SEEN) features of the cells of a frame with label shares (N, FORMS) of mean confidence (N,), seen in
    directions `bearing` (N,), radians clockwise from grid north. A neighbour outside the frame is assumed to look like
    the cell."""
    n = len(rows)
    if n == 0:
        return np.zeros((0, SEEN))
    sure = np.zeros(n) if confidence is None else confidence - USUAL
    top, left = rows.min() - 1, cols.min() - 1
    index = np.full((rows.max() - top + 2, cols.max() - left + 2), -1, np.int64)
    index[rows - top, cols - left] = np.arange(n)
    down, right = away_from_camera(bearing)
    blocks = [np.ones((n, 1)), shares, sure[:, None] * shares]
    for step in (-1, 1):
        beside = index[rows - top + step * down, cols - left + step * right]
        blocks.append(shares[np.where(beside < 0, np.arange(n), beside)])
    return np.concatenate(blocks, axis=1)


def away_from_camera(bearing: NDArray[np.floating]) -> tuple[Int64Array, Int64Array]:
    """Return (N,) rows and columns from a cell to the one behind it, for directions of sight as in `what_is_seen`."""
    return np.rint(-np.cos(bearing)).astype(np.int64), np.rint(np.sin(bearing)).astype(np.int64)


def at_incidence(seen: Float64Array, cosine: Float64Array, incidence: Float64Array) -> Float64Array:
    """Return (N, K SEEN) the features times the interpolation weight of each of the K incidences."""
    weigh = np.stack([np.interp(cosine, incidence, one) for one in np.eye(len(incidence))], axis=1)
    return np.asarray((weigh[:, :, None] * seen[:, None, :]).reshape(len(seen), len(incidence) * seen.shape[1]))
