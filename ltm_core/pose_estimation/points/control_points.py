"""Hold surveyed control points, and find initial poses from a few of them.

With the position known, two points and a focal length give a rotation in closed form (TRIAD: Black 1964); else three
points give up to four poses (P3P: Ding et al., CVPR 2023). Pairs, triples and focal lengths are scored by how many
points they bring near their marks (RANSAC: Fischler and Bolles 1981; for triples, that of OpenCV)."""

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array, Int64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.visibility.footprint import line_of_sight_vectors, pixel_rays


@dataclass(frozen=True, eq=False)
class MarkedPoints:
    """Points of the map that are marked in images. `names`: (N,). `places`: (N, 3) map metres. `pixels`: (N, 2) u, v
    with (0, 0) the centre of the top-left pixel. Raises PoseError that names points without finite values."""

    names: tuple[str, ...]
    places: Float64Array
    pixels: Float64Array

    def __post_init__(self) -> None:
        count = len(self.names)
        for what in [name for name in vars(self) if name != "names"]:
            values = np.array(getattr(self, what), np.float64)
            shape = count, 2 if what == "pixels" else 3
            if values.shape != shape:
                raise PoseError(f"{count} points need {what} {shape}, got {values.shape}")
            if not (finite := np.isfinite(values).all(axis=1)).all():
                raise PoseError(f"points without finite {what}: {', '.join(np.array(self.names)[~finite])}")
            values.flags.writeable = False
            object.__setattr__(self, what, values)


@dataclass(frozen=True, eq=False)
class ControlPoints(MarkedPoints):
    """Surveyed points in one image. Raises PoseError also for points that are given twice."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for what, keys in (
            ("name", self.names),
            ("place on the map", tuple(map(tuple, self.places.tolist()))),
            ("pixel", tuple(map(tuple, self.pixels.tolist()))),
        ):
            twice = [name for name, key in zip(self.names, keys, strict=True) if keys.count(key) > 1]
            if twice:
                raise PoseError(f"control points with the same {what}: {', '.join(twice)}; keep one of each")


@dataclass(frozen=True, eq=False)
class PtzPoints(MarkedPoints):
    """Landmarks in images of a head. `readings`: (N, 3) pan (deg), tilt (deg) and zoom of each one's image."""

    readings: Float64Array


FOCAL_FACTORS = np.geomspace(0.4, 2.5, 41)  # of the stated focal length, tried if it is free
MAX_PAIRS = 400
MIN_SEPARATION = 0.03  # minimum separation of points as a share of the image's diagonal; closer points give no rotation
STARTS = 4
FREE_STARTS = 6


def coarse_poses(
    points: ControlPoints,
    camera: Camera,
    position: Float64Array,
    angles_deg: tuple[float, float, float] | None,
    focal_free: bool,
    position_free: bool,
    bend: float,
) -> list[tuple[Camera, Pose]]:
    """Return the best few starts (camera, pose). Raises PoseError if all points are too close together."""
    diagonal = float(np.hypot(camera.width, camera.height))
    sights = line_of_sight_vectors(position, points.places, bend)
    sights /= np.linalg.norm(sights, axis=1, keepdims=True)
    first, second = _pairs(points, sights, diagonal)
    limit = diagonal * (0.1 if position_free else 0.05)
    candidates: list[tuple[float, Camera, Pose]] = []
    for factor in FOCAL_FACTORS if focal_free else (1.0,):
        scaled = camera.zoomed(float(factor))
        rays = pixel_rays(scaled, points.pixels)
        rotations = _bases(sights[first], sights[second]) @ np.swapaxes(_bases(rays[first], rays[second]), 1, 2)
        costs = _costs(scaled, rotations, sights, points.pixels, limit)
        best = [k for k in np.argsort(costs, kind="stable")[:STARTS] if np.isfinite(rotations[k]).all()]
        candidates += [(float(costs[k]), scaled, Pose(position, _orthonormal(rotations[k]))) for k in best]
    starts = [(camera, pose) for _, camera, pose in sorted(candidates, key=lambda found: found[0])[:STARTS]]
    if position_free:
        starts += _poses_anywhere(points, camera, focal_free, bend, limit)
    if angles_deg is not None:
        starts.append((camera, Pose.from_angles(position, *angles_deg)))
    if not starts:
        raise PoseError(
            f"points {', '.join(points.names)} have no rays with the distortion {camera.distortion}: check it"
        )
    return starts


def _poses_anywhere(
    points: ControlPoints, camera: Camera, focal_free: bool, bend: float, limit: float
) -> list[tuple[Camera, Pose]]:
    """Return the best few (camera, pose) at any position."""
    middle = points.places.mean(axis=0)  # near zero, the solver's polynomials keep their digits
    found: list[tuple[float, Camera, Pose]] = []
    for factor in FOCAL_FACTORS[::2] if focal_free else (1.0,):
        scaled = camera.zoomed(float(factor))
        rays = pixel_rays(scaled, points.pixels)
        seen = np.isfinite(rays).all(axis=1)
        if seen.sum() < 4:
            continue
        marks, near = rays[seen, :2] / rays[seen, 2:], limit / scaled.fx
        known, turn, shift, _ = cv2.solvePnPRansac(
            points.places[seen] - middle, marks, np.eye(3), None, reprojectionError=near, flags=cv2.SOLVEPNP_P3P
        )
        if known and np.isfinite(turn).all() and np.isfinite(shift).all():
            rotation = cv2.Rodrigues(turn)[0].T
            pose = Pose(middle - rotation @ shift[:, 0], rotation)
            sights = line_of_sight_vectors(pose.position, points.places, bend)
            found.append((float(_costs(scaled, rotation[None], sights, points.pixels, limit)[0]), scaled, pose))
    return [(camera, pose) for _, camera, pose in sorted(found, key=lambda start: start[0])[:FREE_STARTS]]


def _pairs(points: ControlPoints, sights: Float64Array, diagonal: float) -> tuple[Int64Array, Int64Array]:
    """Return the pairs of points that stand apart in the image and on the map, at most MAX_PAIRS of them."""
    pairs = np.array(list(combinations(range(len(points.names)), 2)))
    apart = np.linalg.norm(points.pixels[pairs[:, 0]] - points.pixels[pairs[:, 1]], axis=1)
    turn = np.linalg.norm(np.cross(sights[pairs[:, 0]], sights[pairs[:, 1]]), axis=1)
    far = (apart > MIN_SEPARATION * diagonal) & (turn > 1e-3)
    if not far.any():
        raise PoseError(
            f"the control points {', '.join(points.names)} are too close together: they span {apart.max():.0f} px (at "
            f"least {MIN_SEPARATION * diagonal:.0f} px are needed) and {np.degrees(turn.max()):.2g} degrees as seen "
            "from the camera; mark points further apart"
        )
    chosen = pairs[far]
    if len(chosen) > MAX_PAIRS:
        chosen = chosen[np.random.default_rng(0).choice(len(chosen), MAX_PAIRS, replace=False)]
    first, second = chosen.T
    return first, second


def _bases(a: Float64Array, b: Float64Array) -> Float64Array:
    """Return the orthonormal bases (N, 3, 3), as columns, of the planes through unit vectors a and b (N, 3)."""
    middle = a + b
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    normal = np.cross(a, b)
    with np.errstate(invalid="ignore"):
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([middle, normal, np.cross(middle, normal)], axis=-1)


def _costs(
    camera: Camera, rotations: Float64Array, sights: Float64Array, pixels: Float64Array, limit: float
) -> Float64Array:
    """Return the sum over the points of their distances to their marks, each at most `limit` pixels: (K,)."""
    errors = camera.project(sights @ rotations) - pixels
    lengths = np.nan_to_num(np.hypot(errors[..., 0], errors[..., 1]), nan=limit)
    return np.asarray(np.minimum(lengths, limit).sum(axis=1), np.float64)


def _orthonormal(rotation: Float64Array) -> Float64Array:
    u, _, vt = np.linalg.svd(rotation)
    return np.asarray(u @ vt, np.float64)
