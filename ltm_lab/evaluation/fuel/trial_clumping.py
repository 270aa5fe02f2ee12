"""Simulated correlation of label errors in trials, by network, view and frame, and how an evaluation measures it."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from ltm_core.base.types import Float64Array
from ltm_core.fuel.label_errors import LabelCorrelation, LabelErrors

_CONTEXT_M = 60.0
"""Standard deviation of the Gaussian by which the evidence weighs the cells about a cell, metres."""


@dataclass(frozen=True)
class Clumping:
    """Shares of the variance of a Gaussian copula; what is left is each pixel's own.

    `network`: of stands, for whoever looks at them with this network. `view`: of stands, in all frames of one tower.
    `frame`: of clumps of pixels, in one frame. `stand_m`: metres, standard deviation of the Gaussian that makes stands.
    """

    network: float = 0.15
    view: float = 0.15
    frame: float = 0.35
    stand_m: float = 40.0

    @property
    def own(self) -> float:
        return max(1 - self.network - self.view - self.frame, 0.0)

    @property
    def near(self) -> float:
        """Correlation of two places of a stand that are as far apart as a cell's context is wide."""
        return self.stand_m**2 / (self.stand_m**2 + _CONTEXT_M**2 / 2)


def correlation_of(clumping: Clumping, errors: LabelErrors) -> LabelCorrelation:
    """How labels correlate in the mean of the life forms, as a large evaluation would find it."""
    systematic = clumping.network + clumping.view
    latent = systematic + clumping.frame, systematic * clumping.near, systematic, clumping.network
    cell, stand, view, network = (_intraclass(_table(errors), share) for share in latent)
    return LabelCorrelation(cell=cell, stand=stand, view=view, network=network)


def clumping_of(errors: LabelErrors) -> Clumping:
    """The inverse of `correlation_of`, of the correlation that is known of a network."""
    known, table = errors.correlation, _table(errors)
    latent = [_latent(table, value) for value in (known.network, known.view, known.cell)]
    near = min(_latent(table, known.stand) / max(latent[1], 1e-9), 0.95)
    stand_m = _CONTEXT_M * np.sqrt(near / (1 - near) / 2)
    return Clumping(latent[0], latent[1] - latent[0], latent[2] - latent[1], max(float(stand_m), 10.0))


def _table(errors: LabelErrors) -> Float64Array:
    return np.where(np.isnan(errors.shares), np.eye(len(errors.shares)), errors.shares)


def _latent(table: Float64Array, intraclass: float) -> float:
    top = 0.995
    if intraclass >= _intraclass(table, top):
        return top
    return float(brentq(lambda share: _intraclass(table, share) - intraclass, 0.0, top, xtol=1e-4))


def _intraclass(table: Float64Array, latent: float) -> float:
    """Correlation of two labels of one form, whose Gaussian variables share `latent` of their variance."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    bounds = ndtri(np.clip(np.cumsum(-np.sort(-table, axis=1), axis=1), 0.0, 1.0))
    given = ndtr((bounds[..., None] - np.sqrt(latent) * nodes) / np.sqrt(1 - latent))
    both = (np.diff(given, axis=1, prepend=0.0) ** 2 @ weights / weights.sum()).sum(axis=1)
    by_chance = (table**2).sum(axis=1)
    used = by_chance < 1
    return float(np.mean((both - by_chance)[used] / (1 - by_chance)[used]))
