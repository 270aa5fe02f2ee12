"""Find starts for the fit of a PTZ mount: mounts in closed form, from pairs of landmarks and each sign of the axes.

The directions to the landmarks in the PTZ head's axes are turned onto those on the map (Wahba's problem, Kabsch 1976).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.zoom_lens import ZoomLens
from ltm_core.pose_estimation.mount.mount_model import MountModel, Sign, ptz_angles, ptz_rotation
from ltm_core.pose_estimation.points.control_points import PtzPoints
from ltm_core.visibility.footprint import line_of_sight_vectors, pixel_rays

STEEPEST_LEAN = math.radians(20.0)
"""Maximum lean of a mount from its stated orientation."""
_REACHED = 3
"""Number of landmarks that must fit the mount of a pair before it is fitted to all of them."""
_MOST_PAIRS = 200


def closed_forms(
    points: PtzPoints, start: MountModel, lens: ZoomLens, bend: float
) -> dict[tuple[Sign, Sign], MountModel]:
    """Return, for each sign of pan and tilt (the stated ones first), the mount that most landmarks agree on, without a
    tilt zero."""
    sights = line_of_sight_vectors(start.base.position, points.places, bend)
    sights /= np.linalg.norm(sights, axis=1, keepdims=True)
    cameras = [lens.camera(zoom) for zoom in points.readings[:, 2]]
    rays = np.array([pixel_rays(c, p[None])[0] for c, p in zip(cameras, points.pixels, strict=True)])
    either: tuple[Sign, Sign] = (1, -1)
    found = {}
    order = sorted(itertools.product(either, either), key=lambda signs: signs != (start.pan_sign, start.tilt_sign))
    for pan_sign, tilt_sign in order:
        turns = np.array([ptz_rotation(*ptz_angles(p, t, pan_sign, tilt_sign)) for p, t, _ in points.readings])
        best = _best_rotation(np.einsum("nij,nj->ni", turns, rays), sights, start)
        if best is not None:
            base = Pose(start.base.position, best)
            found[pan_sign, tilt_sign] = replace(
                start, base=base, tilt_zero=0.0, pan_sign=pan_sign, tilt_sign=tilt_sign
            )
    return found


def _best_rotation(in_ptz: Float64Array, sights: Float64Array, start: MountModel) -> Float64Array | None:
    """Return the median angle (rad) left, and the mount's rotation: the best of those from pairs, then from those
    within reach."""
    pairs = list(itertools.combinations(range(len(sights)), 2))
    pairs = [pairs[k] for k in np.linspace(0, len(pairs) - 1, min(len(pairs), _MOST_PAIRS)).astype(int)]
    best: tuple[float, Float64Array] | None = None
    for pair in pairs:
        two = list(pair)
        if np.linalg.norm(np.cross(sights[two[0]], sights[two[1]])) < 0.01:
            continue
        rotation = _aligned(in_ptz[two], sights[two])
        off = _angles_off(rotation, in_ptz, sights)
        near = off <= max(2 * float(np.median(off)), math.radians(0.5))
        if near.sum() >= _REACHED:
            rotation = _aligned(in_ptz[near], sights[near])
        median = float(np.median(_angles_off(rotation, in_ptz, sights)))
        if _lean_between(rotation, start.base.rotation) <= STEEPEST_LEAN and (best is None or median < best[0]):
            best = median, rotation
    return None if best is None else best[1]


def _aligned(in_ptz: Float64Array, sights: Float64Array) -> Float64Array:
    """Return the rotation that turns directions (N, 3) onto others with the least squares."""
    u, _, vt = np.linalg.svd(sights.T @ in_ptz)
    turn = np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)])
    return np.asarray(u @ turn @ vt, np.float64)


def _angles_off(rotation: Float64Array, in_ptz: Float64Array, sights: Float64Array) -> Float64Array:
    cosine = np.einsum("ni,ni->n", in_ptz @ rotation.T, sights)
    return np.asarray(np.arccos(np.clip(cosine, -1, 1)), np.float64)


def _lean_between(a: Float64Array, b: Float64Array) -> float:
    """Between the upright axes of two mounts, rad."""
    return math.acos(float(np.clip(a[:, 1] @ b[:, 1], -1, 1)))
