from __future__ import annotations

import numpy as np
import pytest

from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator import noise_fields
from ltm_lab.simulator.ground_mesh import line_of_sight
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
