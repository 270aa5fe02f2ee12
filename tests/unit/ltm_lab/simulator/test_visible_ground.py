"""What an eye cannot see is left out of its scene, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator import noise_fields
from ltm_lab.simulator.ground_mesh import line_of_sight, seen_from
from ltm_lab.simulator.terrain_synthesis import HeightField

BEND = 6.8e-8


def hills(seed: int) -> HeightField:
    geometry = GridGeometry(-900.0, 2100.0, 10.0, 330, 290)
    empty = HeightField(np.empty((0, 0), np.float32), geometry)
    return HeightField(
        (300 + 170 * noise_fields.fractal(*empty.axes(), 900.0, seed, octaves=5)).astype(np.float32), geometry
    )


@pytest.mark.parametrize(("seed", "mast"), [(1, 20.0), (2, 3.0), (5, 60.0)])
def test_whatever_shows_is_seen(seed: int, mast: float) -> None:
    """Against lines drawn to the tops of trees that stand anywhere: none that shows is left out, many others are."""
    ground = hills(seed)
    eye = np.array([310.0, 420.0, float(ground.at(310.0, 420.0)) + mast])
    sight = line_of_sight(ground, eye, 24.0, BEND)
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-880, 2380, 4000), rng.uniform(-780, 2080, 4000)
    t = np.linspace(0.02, 0.995, 500)[:, None]
    away = np.hypot(x - eye[0], y - eye[1])
    line = eye[2] + t * (ground.at(x, y) + 20.0 - BEND * away**2 - eye[2])
    under = ground.at(eye[0] + t * (x - eye[0]), eye[1] + t * (y - eye[1])) - BEND * (t * away) ** 2
    shows = np.all(line > under, axis=0)
    assert 0.05 < shows.mean() < 0.7
    assert np.all(sight.at(x[shows], y[shows]))
    assert np.mean(~sight.at(x[~shows], y[~shows])) > 0.3, "much of what is hidden"


def test_a_shear_moves_the_point_about_which_ground_sinks() -> None:
    rng = np.random.default_rng(4)
    points = rng.uniform(-4000, 4000, (50, 3))
    center, eye = np.array([2000.0, 1800.0]), np.array([310.0, 2420.0, 700.0])
    about_center = points - np.stack(
        [0 * points[:, 0], 0 * points[:, 0], BEND * ((points[:, :2] - center) ** 2).sum(1)], 1
    )
    about_eye = points[:, 2] - BEND * ((points[:, :2] - eye[:2]) ** 2).sum(axis=1)
    m = seen_from(eye, center, BEND)
    np.testing.assert_allclose((about_center @ m[:3, :3].T + m[:3, 3])[:, 2], about_eye, atol=1e-9)
    np.testing.assert_array_equal(m[:2, :3], np.eye(3)[:2])
