"""Photos of people who walk through a scenario with a phone in the hand."""

from __future__ import annotations

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose
from ltm_lab.simulator.camera_setup import WalkConfig
from ltm_lab.simulator.terrain_synthesis import HeightField


def walked_stops(path: list[tuple[float, float]], stops: int) -> tuple[Float64Array, float]:
    """Places (stops, 2) at even distances along a path, its ends among them, and metres between two of them."""
    corners = np.array(path, np.float64)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], stops)
    places = np.column_stack([np.interp(at, along, corners[:, axis]) for axis in (0, 1)])
    return places, float(along[-1]) / (stops - 1)


def walk_photos(walk: WalkConfig, ground: HeightField, seed: int) -> list[tuple[float, Pose, bool]]:
    """Seconds since the start, true pose, and whether the phone is held upright (portrait), of each photo."""
    rng = np.random.default_rng([seed, 107, *walk.name.encode()])
    places, apart = walked_stops(walk.path, walk.stops)
    begins = apart / walk.speed + walk.interval_s * walk.photos
    photos = []
    for stop, (x, y) in enumerate(places):
        eye = np.array([x, y, float(ground.at(x, y)) + walk.eye])
        for k in range(walk.photos):
            number = stop * walk.photos + k
            pitch, roll = walk.sway_deg * rng.normal(size=2)
            pose = Pose.from_angles(
                eye,
                walk.azimuth_deg[number % len(walk.azimuth_deg)],
                walk.pitch_deg[number % len(walk.pitch_deg)] + pitch,
                roll,
            )
            photos.append((stop * begins + k * walk.interval_s, pose, walk.portrait[number % len(walk.portrait)]))
    return photos
