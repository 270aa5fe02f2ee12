import math

import numpy as np
import pytest

from ltm_core.geometry.grid import GridGeometry
from ltm_core.locating.locator import Posterior, reach_in_ellipse

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
        assert area(posterior, share) == pytest.approx(np.pi * ellipse.major * ellipse.minor, rel=0.03)
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
    assert area(posterior, 0.95) < 0.2 * np.pi * ellipse.major * ellipse.minor
