"""Whether a depth knows what is nearer: pairs of points in the right order."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.base.errors import ImageError


@dataclass(frozen=True)
class DepthOrder:
    """`pairs` of points whose true depths differ clearly; `right`: the share of them that is ordered rightly."""

    pairs: int
    right: float


def depth_order(estimate: ArrayLike, truth: ArrayLike, least_ratio: float = 1.1) -> DepthOrder:
    """Pairwise order of points (N,) whose true depths differ by `least_ratio` or more; ties are wrong.

    For inverse depth give its negative. After the ordinal error of Chen et al., Single-Image Depth Perception in the
    Wild (2016). Points without a finite estimate or truth are left out. Raises ImageError on different lengths.
    """
    given, true = np.asarray(estimate, np.float64), np.asarray(truth, np.float64)
    if given.shape != true.shape or given.ndim != 1:
        raise ImageError(f"order of {given.shape} estimates cannot be scored against {true.shape} true depths")
    known = np.isfinite(given) & np.isfinite(true)
    given, true = given[known], true[known]
    clear = true[None, :] > least_ratio * true[:, None]
    pairs = int(clear.sum())
    right = int((clear & (given[None, :] > given[:, None])).sum())
    return DepthOrder(pairs, right / pairs if pairs else float("nan"))
