from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import norm

from ltm_core.geometry.grid import GridGeometry
from ltm_core.locating.directions import KNOTS, DirectionTable, SightLikelihood, sight_likelihood
from ltm_core.locating.posterior import Posterior, reach_in_ellipse
from ltm_core.locating.sight_fan import SightFan, sight_fan
from ltm_core.raster.dem import Dem

GEOMETRY = GridGeometry(-300.0, 220.0, 2.0, 310, 205)


def normal(mean: tuple[float, float], covariance: np.ndarray) -> np.ndarray:
    row, col = np.mgrid[0:205, 0:310]
    off = np.stack(GEOMETRY.to_map(row, col), axis=-1) - np.array(mean)
    return np.exp(-0.5 * np.einsum("...i,ij,...j", off, np.linalg.inv(covariance), off))


def area(posterior: Posterior, share: float) -> float:
    return float(posterior.densest(share).sum()) * posterior.geometry.resolution**2


def test_a_normal_distribution_has_the_usual_ellipses() -> None:
    azimuth = math.radians(35.0)
    along, across = np.array([math.sin(azimuth), math.cos(azimuth)]), np.array([math.cos(azimuth), -math.sin(azimuth)])
    covariance = 40.0**2 * np.outer(along, along) + 9.0**2 * np.outer(across, across)
    posterior = Posterior.of_raster(normal((20.0, -10.0), covariance), GEOMETRY)
    assert posterior is not None
    assert posterior.mean == pytest.approx((20.0, -10.0), abs=0.05)
    assert posterior.covariance == pytest.approx(covariance, rel=0.01, abs=1.0)
    for share in (0.5, 0.95):
        scale = math.sqrt(-2 * math.log(1 - share))
        ellipse = posterior.ellipse(share)
        assert (ellipse.major, ellipse.minor) == pytest.approx((40 * scale, 9 * scale), rel=0.02)
        assert ellipse.azimuth_deg == pytest.approx(35.0, abs=0.2)
        # The densest region of a normal distribution is its ellipse.
        assert area(posterior, share) == pytest.approx(ellipse.area, rel=0.03)
    assert len(posterior.modes) == 1


def test_ellipses_of_two_modes_hold_what_they_say() -> None:
    near, far = normal((-150.0, -60.0), np.eye(2) * 8.0**2), normal((180.0, 90.0), np.eye(2) * 16.0**2)
    posterior = Posterior.of_raster(near / near.sum() * 0.7 + far / far.sum() * 0.3, GEOMETRY)
    assert posterior is not None
    first, second = posterior.modes
    assert (first.share, second.share) == pytest.approx((0.7, 0.3), abs=0.05)
    assert first.centre == pytest.approx((-150.0, -60.0), abs=0.5)
    assert second.centre == pytest.approx((180.0, 90.0), abs=0.5)
    for share in (0.5, 0.95):
        ellipse = posterior.ellipse(share)
        held = reach_in_ellipse(ellipse, posterior.places) <= 1
        assert posterior.probability[held].sum() == pytest.approx(share, abs=0.02)
    assert area(posterior, 0.95) < 0.2 * posterior.ellipse(0.95).area


SIGMA, MARK = 0.5, 0.003
"""Metres of the terrain's heights; of the marked slope."""
EYE = np.array([0.0, 0.0, 10.0])


def walls() -> Dem:
    """Ground at -200 m with two walls across, 50 to 70 m and 1000 to 1020 m north of the camera: at 3 and -89 m."""
    geometry = GridGeometry(-105.0, 2505.0, 10.0, 21, 270)
    _, y = geometry.to_map(np.arange(geometry.height), 0)
    profile = np.full(len(y), -200.0)
    profile[(y > 45) & (y < 75)] = 3.0
    profile[(y > 995) & (y < 1025)] = -89.0
    return Dem(np.repeat(profile[:, None], geometry.width, axis=1).astype(np.float32), geometry)


def marked(slope: float, turned: bool = False, lean: float = 0.0) -> tuple[SightFan, SightLikelihood]:
    fan = sight_fan(walls(), EYE, np.linspace(-1e-3, 1e-3, 3), 2400.0)
    shape = (3, len(KNOTS))
    table = DirectionTable(np.ones((1, *shape)), np.full(shape, slope), np.full(shape, MARK**2))
    variances, apart = np.array([SIGMA**2]), np.array([40.0])
    return fan, sight_likelihood(fan, table, 10.0, 0.0, variances, apart, True, lean, turned)


@pytest.mark.kernel
@pytest.mark.parametrize("slope", [-0.106, -0.1, -0.094, -0.086])
def test_smoke_comes_up_over_the_higher_of_two_uncertain_crests(slope: float) -> None:
    fan, likelihood = marked(slope)
    r, slopes = fan.ranges, (fan.heights[1] - EYE[2]) / fan.ranges
    means, sigmas = [], []
    for stretch in ((r > 40) & (r < 80), (r > 990) & (r < 1030)):
        best = np.flatnonzero(stretch)[slopes[stretch].argmax()]
        means.append(slopes[best])
        sigmas.append(SIGMA / r[best])
    x = np.linspace(-0.2, 0.0, 20_001)
    first, second = (norm.pdf(x, m, s) for m, s in zip(means, sigmas, strict=True))
    highest = first * ndtr((x - means[1]) / sigmas[1]) + second * ndtr((x - means[0]) / sigmas[0])
    expected = float((highest * norm.pdf(slope, x, MARK)).sum() * (x[1] - x[0]))
    behind = likelihood.density[1, (r > 1500) & (r < 2000)]
    assert behind == pytest.approx(np.full(len(behind), expected), rel=0.05)
