"""Where terrain and network disagree: what each is worth in one pixel, and what is made of both."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from ltm_core.depth.answers import meant

Image = NDArray[np.float32]
Row = NDArray[np.float32]

VANISHED = 0.01
"""Chance that the ground of a pixel is gone, so that something farther shows."""
FOOTLESS_ODDS = -1.0
"""Log odds of what stands (see `classes.STANDING`) for what has no foot; for an edge as high as the disagreement, and
less by its square; for each e-folding of the disagreement's square, in variances. With those of the classes from a
logistic regression of which of the two is nearer to the truth, in logarithms: over pixels of the demo's photos, those
of `training_a` and of another rendered site, as they are and with a fifth hidden, with this project's network and
TCMonoDepth."""
_EDGE_ODDS, _SIGMA_ODDS = -0.8, 0.44
_MOST_RATIO = 3.0  # e-foldings of depth from which on odds grow no more
MEAN_RATIO, MEAN_CHANCE = 0.7, 0.25  # e-foldings within which, and chance from which on, the mean of both is taken
_ELSEWHERE = 8.0  # times a network's variance on ground: its variance on what stands before it, measured on trees
_BETWEEN = 0.3  # of the range of a network's depth among neighbours: sigma of which of them a pixel shows
_RANGES = 3.0  # e-foldings of depth over which what shows where ground is gone may be, each as likely


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def least(odds: Row) -> float:
    """Variances of a disagreement below which `weigh` never departs from the terrain where a class has such `odds`."""
    alone = -odds[0] - max(_MOST_RATIO * odds[1], 0.0)
    mean = np.log(MEAN_CHANCE / (1 - MEAN_CHANCE)) - odds[0] - max(MEAN_RATIO * odds[1], 0.0)
    return float(np.exp(min(alone, mean) / _SIGMA_ODDS))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def gone(
    y: np.float32,
    near: np.float32,
    back: np.float32,
    off: np.float32,
    joint: np.float32,
    spread: np.float32,
    gross: np.float32,
) -> bool:
    """Whether the ground of a pixel is gone; not asked at edges, where the far side, or sky, may have leaked in.

    `y`: what the network sees, `near` and `back` its neighbours. `off`: by how much it is nearer than it would say of
    the terrain, with variance `joint`, of its own `spread`.
    """
    if not near - back < -off:
        return False
    half, one, chance = np.float32(0.5), np.float32(1.0), np.float32(VANISHED)
    fits = np.exp(-half * off * off / joint) / np.sqrt(np.float32(2 * np.pi) * joint)
    density = one / (np.float32(_RANGES) * max(y, spread))
    return bool(chance * density > (one - chance) * ((one - gross) * fits + gross * density))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def of_network(
    read: np.float32, near: np.float32, back: np.float32, at: tuple[int, int], shift: Image, factor: Image
) -> tuple[np.float32, np.float32]:
    """The inverse depth that the network means where it says `read`, and its sigma, 1/m; 0 where that says nothing."""
    if not read > 0:
        return np.float32(0.0), np.float32(0.0)
    inverse, t = meant(at[0], at[1], read, shift, factor)
    if not t < inverse:
        return np.float32(0.0), np.float32(0.0)
    # Which of its neighbours' depths it is stays unsure.
    between = np.float32(_BETWEEN) * (near - back)
    return inverse, np.sqrt(np.float32(_ELSEWHERE) * t * t + between * between)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def stands(inverse: np.float32, true: np.float32, edge: np.float32, square: np.float32, odds: Row) -> np.float32:
    """Log odds that something stands at `inverse` depth before a terrain at `true`, which the network contradicts by
    `square` variances."""
    ratio = np.float32(_MOST_RATIO)
    if true * np.float32(np.exp(_MOST_RATIO)) > inverse:
        ratio = np.log(inverse / true)
    return np.float32(
        odds[0] + odds[1] * ratio + np.float32(_EDGE_ODDS) * edge * edge + np.float32(_SIGMA_ODDS) * np.log(square)
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def weigh(
    d: Row, s: Row, kind: NDArray[np.uint8], u: int, inverse: np.float32, t: np.float32, odds: np.float32
) -> None:
    """Terrain or what stands before it, in pixel `u` of a row: between two that are apart lies nothing but air, but of
    two that are near each other the mean by their chances is least wrong."""
    one = np.float32(1.0)
    z, sure = one / inverse, odds > 0
    if d[u] < np.float32(np.exp(MEAN_RATIO)) * z:
        chance = one / (one + np.exp(-odds))
        if chance > np.float32(MEAN_CHANCE):
            apart, own = d[u] - z, t * z * z
            d[u] -= chance * apart
            s[u] = np.sqrt(chance * own * own + (one - chance) * (s[u] * s[u] + chance * apart * apart))
            kind[u] = 2 if sure else 3
    elif sure:
        take(d, s, kind, u, inverse, t)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def take(d: Row, s: Row, kind: NDArray[np.uint8], u: int, inverse: np.float32, t: np.float32) -> None:
    """The network's depth in pixel `u` of a row, if it has one."""
    if inverse > 0:
        d[u] = np.float32(1.0) / inverse
        s[u], kind[u] = t * d[u] * d[u], 2
