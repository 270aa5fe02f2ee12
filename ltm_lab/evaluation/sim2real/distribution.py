"""Distances between two sets of image features: FID and KID, with intervals.

FID: Heusel et al. 2017, "GANs trained by a two time-scale update rule". KID: Binkowski et al. 2018, "Demystifying MMD
GANs". Both take the 2048 pool features of one certain InceptionV3; on features of any other network the numbers are
another metric and must not bear these names."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float64Array

Features = NDArray[np.floating[Any]]
FEATURES = 2048
"""Below this number of images the covariance that FID takes is singular."""


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float


def frechet_distance(a: Features, b: Features) -> float:
    """FID of features (N, D) and (M, D), N and M at least 2: the squared Frechet distance of two Gaussians.

    The trace of the root of the covariances' product is the sum of the singular values of a product of their factors,
    so that singular covariances need no care. Raises ImageError on too few features or different widths."""
    _check(a, b)
    means = a.mean(axis=0, dtype=np.float64) - b.mean(axis=0, dtype=np.float64)
    factor_a, factor_b = _factor(a), _factor(b)
    cross = float(np.linalg.svd(factor_a @ factor_b.T, compute_uv=False).sum())
    return float(means @ means + (factor_a**2).sum() + (factor_b**2).sum() - 2 * cross)


def kernel_distance(a: Features, b: Features) -> float:
    """KID: the unbiased squared MMD with the kernel (x.y / D + 1)^3 of features (N, D) and (M, D); may be negative.

    Raises ImageError as `frechet_distance` does."""
    _check(a, b)
    n, m = len(a), len(b)
    aa, bb, ab = _kernel(a, a), _kernel(b, b), _kernel(a, b)
    within_a = (aa.sum() - np.trace(aa)) / (n * (n - 1))
    within_b = (bb.sum() - np.trace(bb)) / (m * (m - 1))
    return float(within_a + within_b - 2 * ab.mean())


def with_interval(
    distance: Callable[[Features, Features], float],
    a: Features,
    b: Features,
    seed: int = 0,
    resamples: int = 200,
) -> Estimate:
    """The distance and its 95 % interval from halves of both sets, drawn without replacement (delete-half jackknife).

    A bootstrap would put the same image in a sample twice, which raises both distances; the spread of the halves'
    values is the standard error of the whole (Shao and Wu 1989), and the interval is 1.96 of it to both sides."""
    value = distance(a, b)
    if min(len(a), len(b)) < 4:
        return Estimate(value, float("nan"), float("nan"))
    rng = np.random.default_rng(seed)
    halves = [
        distance(a[rng.choice(len(a), len(a) // 2, replace=False)], b[rng.choice(len(b), len(b) // 2, replace=False)])
        for _ in range(resamples)
    ]
    error = 1.96 * float(np.std(halves, ddof=1))
    return Estimate(value, value - error, value + error)


def mean_with_interval(values: NDArray[np.floating[Any]], seed: int = 0, resamples: int = 2000) -> Estimate:
    """The mean of one value a pair and its 95 % percentile bootstrap interval over the pairs."""
    values = np.asarray(values, np.float64)
    if values.size == 0:
        raise ImageError("no pair of images: nothing to average")
    rng = np.random.default_rng(seed)
    means = values[rng.integers(0, len(values), (resamples, len(values)))].mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return Estimate(float(values.mean()), float(low), float(high))


def _factor(features: Features) -> Float64Array:
    """F of at most D rows with F^T F the covariance of the features."""
    centred = features.astype(np.float64) - features.mean(axis=0, dtype=np.float64)
    centred /= np.sqrt(len(features) - 1)
    return np.asarray(np.linalg.qr(centred, mode="r")) if len(centred) > centred.shape[1] else centred


def _kernel(a: Features, b: Features) -> Float64Array:
    return np.asarray((a.astype(np.float64) @ b.astype(np.float64).T / a.shape[1] + 1) ** 3)


def _check(a: Features, b: Features) -> None:
    if a.ndim != 2 or b.ndim != 2 or a.shape[1] != b.shape[1] or min(len(a), len(b)) < 2:
        raise ImageError(f"features of {a.shape} and {b.shape}: both must be (N, D) with one D and at least 2 images")
