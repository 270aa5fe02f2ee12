"""Draws camera positions: seeded knolls and slopes of a site."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ltm_core.base.types import Float64Array
from ltm_lab.simulator.camera_setup import ViewsConfig
from ltm_lab.simulator.terrain_synthesis import HeightField


@dataclass(frozen=True)
class Viewpoint:
    """One picture to take: eye (3,) in the map frame, angles and horizontal field of view in degrees."""

    eye: Float64Array
    azimuth_deg: float
    pitch_deg: float
    roll_deg: float
    hfov_deg: float


def draw_viewpoints(site: HeightField, config: ViewsConfig, seed: int) -> list[list[Viewpoint]]:
    """`config.positions` lists of `config.views` viewpoints; every other position is a knoll, the rest lie anywhere
    (`config.slopes`) or are knolls, too.

    Headings that look straight into the slope beside the camera are drawn again (eight times at most).
    """
    rng = np.random.default_rng([seed, 41])
    g = site.geometry
    size = g.width * g.resolution
    broad = ndimage.gaussian_filter(site.elevation, 180.0 / g.resolution)
    prominence = HeightField((site.elevation - broad).astype(np.float32), g)
    out: list[list[Viewpoint]] = []
    for i in range(config.positions):
        candidates = np.array([g.x_min, g.y_min]) + size * rng.uniform(
            0.08, 0.92, (1 if config.slopes and i % 2 else 60, 2)
        )
        x, y = candidates[int(np.argmax(prominence.at(candidates[:, 0], candidates[:, 1])))]
        eye = np.array([x, y, float(site.at(x, y)) + rng.uniform(*config.mast)])
        views = []
        for _ in range(config.views):
            pitch = rng.uniform(*config.pitch_deg)
            azimuth = 0.0
            for _ in range(8):
                azimuth = rng.uniform(0, 360)
                ahead = np.array([40.0, 90.0, 160.0])
                z = site.at(x + ahead * np.sin(np.radians(azimuth)), y + ahead * np.cos(np.radians(azimuth)))
                if np.all(z - eye[2] < ahead * np.tan(np.radians(max(pitch, -4.0) + 6.0))):
                    break
            views.append(Viewpoint(eye, azimuth, pitch, rng.uniform(*config.roll_deg), rng.uniform(*config.hfov_deg)))
        out.append(views)
    return out
