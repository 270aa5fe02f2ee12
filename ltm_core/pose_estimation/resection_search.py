"""Initial poses of a resection, from pairs of control points.

With the position known, two points and a focal length give a rotation in closed form (TRIAD: Black 1964). All pairs and
a range of focal lengths are tried and scored by how many points they bring near their marks, so that a start is found
without angles and in spite of gross errors, after the idea of RANSAC (Fischler and Bolles 1981).
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from ltm_core.camera import Camera
from ltm_core.errors import PoseError
from ltm_core.pose import Pose
from ltm_core.pose_estimation.control_points import ControlPoints
from ltm_core.types import Float64Array, Int64Array
from ltm_core.visibility.line_of_sight import line_of_sight_vectors, pixel_rays

FOCAL_FACTORS = np.geomspace(0.4, 2.5, 41)
"""Shares of the stated focal length that are tried where it is free: steps of 5 %."""
MAX_PAIRS = 400
MIN_SEPARATION = 0.03
"""Of the image's diagonal: points that are closer give no rotation."""
STARTS = 4


def coarse_poses(
    points: ControlPoints,
    camera: Camera,
    position: Float64Array,
    angles_deg: tuple[float, float, float] | None,
    focal_free: bool,
    position_free: bool,
    bend: float,
) -> list[tuple[Camera, Pose]]:
    """The best few (camera, pose) to start from. Raises PoseError where all points are crowded together."""
    diagonal = float(np.hypot(camera.width, camera.height))
    sights = line_of_sight_vectors(position, points.places, bend)
    sights /= np.linalg.norm(sights, axis=1, keepdims=True)
    first, second = _pairs(points, sights, diagonal)
    limit = diagonal * (0.1 if position_free else 0.05)

    candidates: list[tuple[float, Camera, Pose]] = []
    for factor in FOCAL_FACTORS if focal_free else (1.0,):
        scaled = replace(camera, fx=camera.fx * float(factor), fy=camera.fy * float(factor))
        rays = pixel_rays(scaled, points.pixels)
        rotations = _bases(sights[first], sights[second]) @ np.swapaxes(_bases(rays[first], rays[second]), 1, 2)
        costs = _costs(scaled, rotations, sights, points.pixels, limit)
        for k in np.argsort(costs, kind="stable")[:STARTS]:
            if np.isfinite(rotations[k]).all():
                candidates.append((float(costs[k]), scaled, Pose(position, _orthonormal(rotations[k]))))
    candidates.sort(key=lambda candidate: candidate[0])
    starts = [(camera, pose) for _, camera, pose in candidates[:STARTS]]
    if angles_deg is not None:
        starts.append((camera, Pose.from_angles(position, *angles_deg)))
    if not starts:
        raise PoseError(
            f"the pixels of the control points {', '.join(points.names)} have no rays under the distortion "
            f"{camera.distortion}: check it"
        )
    return starts


def _pairs(points: ControlPoints, sights: Float64Array, diagonal: float) -> tuple[Int64Array, Int64Array]:
    """Pairs of points that stand apart in the image and on the map, at most MAX_PAIRS of them."""
    pairs = np.array(list(combinations(range(len(points.names)), 2)))
    apart = np.linalg.norm(points.pixels[pairs[:, 0]] - points.pixels[pairs[:, 1]], axis=1)
    turn = np.linalg.norm(np.cross(sights[pairs[:, 0]], sights[pairs[:, 1]]), axis=1)
    far = (apart > MIN_SEPARATION * diagonal) & (turn > 1e-3)
    if not far.any():
        raise PoseError(
            f"the control points {', '.join(points.names)} crowd in one place: they span {apart.max():.0f} px of the "
            f"image (at least {MIN_SEPARATION * diagonal:.0f} px are needed) and {np.degrees(turn.max()):.2g} degrees "
            "seen from the camera; mark points further apart"
        )
    pairs = pairs[far]
    if len(pairs) > MAX_PAIRS:
        pairs = pairs[np.random.default_rng(0).choice(len(pairs), MAX_PAIRS, replace=False)]
    return pairs[:, 0], pairs[:, 1]


def _bases(a: Float64Array, b: Float64Array) -> Float64Array:
    """Orthonormal bases (N, 3, 3), as columns, of the planes through unit vectors a and b (N, 3)."""
    middle = a + b
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    normal = np.cross(a, b)
    with np.errstate(invalid="ignore"):
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([middle, normal, np.cross(middle, normal)], axis=-1)


def _costs(
    camera: Camera, rotations: Float64Array, sights: Float64Array, pixels: Float64Array, limit: float
) -> Float64Array:
    """Sum over the points of their distances to their marks, each at most `limit` pixels: (K,)."""
    errors = camera.project(sights @ rotations) - pixels
    lengths = np.nan_to_num(np.hypot(errors[..., 0], errors[..., 1]), nan=limit)
    return np.asarray(np.minimum(lengths, limit).sum(axis=1), np.float64)


def _orthonormal(rotation: Float64Array) -> Float64Array:
    u, _, vt = np.linalg.svd(rotation)
    return np.asarray(u @ vt, np.float64)
