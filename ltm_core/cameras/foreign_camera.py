"""Convert poses and lenses of other tools: axes, rotation angles, Earth-centred coordinates, and other lens models."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy  # loads its parts when they are first used
from pyproj import Transformer

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import Pose, matrix_of_angles

UPWARD = np.diag([1.0, -1.0, -1.0])
"""Rotation between camera axes x right, y down, z forward, and x right, y up, z backward."""
_EARTH = 6.3e6, 6.4e6
"""Distances from the origin in metres between which coordinates are Earth-centred (EPSG:4978)."""
_HIGHEST = 10e3
"""Height in metres above which a coordinate is no height on a map, whose northings may be as long as that distance."""
MOST_LENS_ERROR = 0.5
"""Maximum distance in pixels between another lens model and the closest one of LTM."""


@dataclass(frozen=True, eq=False)
class ForeignPose:
    """A photo's pose and camera as another tool states them.

    `position`: (3,) map coordinates without an origin, or Earth-centred. `rotation`: (3, 3) from optical axes to east,
    north, up. `place`: file and entry, for errors. `camera`: None if the file states no lens. `angles`: (3,) the stated
    rotation angles, by which `turned` makes the rotation. `target`: (3,) a point on the optical axis, stated instead of
    the pitch; its height and that of the position are then above the ground."""

    name: str
    place: str
    position: Float64Array
    rotation: Float64Array
    camera: Camera | None
    earth: bool = False
    angles: Float64Array | None = None
    turned: Callable[[Float64Array], Float64Array] | None = None
    target: Float64Array | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.position).all() and np.isfinite(self.rotation).all()):
            raise PoseError(f"{self.place}: position and rotation must be finite")
        off = np.abs(self.rotation @ self.rotation.T - np.eye(3)).max()
        if off > 1e-3 or np.linalg.det(self.rotation) < 0:
            raise PoseError(f"{self.place}: the matrix is no rotation (it is off by {off:.2g})")

    def with_rotation(self, rotation: Float64Array) -> "ForeignPose":
        return replace(self, rotation=rotation)

    def pose(self, frame: SiteFrame, ground: Callable[[float, float], float], undulation: float) -> Pose:
        """Return the pose in a map frame. `undulation`: of the geoid, subtracted from Earth-centred heights, metres."""
        left, _, right = np.linalg.svd(self.rotation)
        rotation = left @ right
        x, y, z = (float(v) for v in self.position)
        if self.earth or (_EARTH[0] < math.hypot(x, y, z) < _EARTH[1] and abs(z) > _HIGHEST):
            lon, lat, height = _geodetic().transform(x, y, z)
            rotation = east_north_up(lon, lat) @ rotation
            x, y = (float(v) for v in frame.from_lonlat(lon, lat))
            turn = matrix_of_angles("Z", -frame.true_to_grid_deg(0.0, x, y), degrees=True)
            return Pose(np.array([x, y, height - undulation]), turn @ rotation)
        origin = np.array([frame.x_origin, frame.y_origin, 0.0])
        place = self.position - origin
        if self.target is None:
            return Pose(place, rotation)
        aim = self.target - origin
        for point in (place, aim):
            point[2] += ground(*point[:2])
        azimuth, _, roll = Pose(place, rotation).angles_deg
        way = aim - place
        return Pose.from_angles(place, azimuth, math.degrees(math.atan2(way[2], math.hypot(way[0], way[1]))), roll)


@lru_cache(maxsize=1)
def _geodetic() -> Transformer:
    return Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)


def east_north_up(lon: float, lat: float) -> Float64Array:
    """Return the rotation (3, 3) from Earth-centred axes to east, north, up."""
    return matrix_of_angles("ZX", [90 + lon, 90 - lat], degrees=True).T


def earth_centred(reference: Float64Array, local: Float64Array) -> Float64Array:
    """Return Earth-centred coordinates (3,) of metres east, north, up of a (latitude, longitude, altitude)."""
    lat, lon, altitude = reference
    origin = _geodetic().transform(lon, lat, altitude, direction="INVERSE")
    return np.asarray(np.array(origin) + east_north_up(lon, lat).T @ local, np.float64)


def omega_phi_kappa(radians: Float64Array) -> Float64Array:
    """Return the rotation, optical to map, of omega, phi and kappa: Rx Ry Rz of axes x right, y up, z backward."""
    return np.asarray(matrix_of_angles("XYZ", radians) @ UPWARD, np.float64)


UNITS = {"degrees": np.pi / 180, "radians": 1.0, "gon": np.pi / 200}


def alternatives(pose: ForeignPose) -> dict[str, ForeignPose]:
    """Return the pose as stated and as it would be with other axes, units or image sides."""
    r = pose.rotation
    found = {
        "as stated": pose,
        "with camera axes y up, z backward": pose.with_rotation(r @ UPWARD),
        "with the rotation inverted": pose.with_rotation(r.T),
        "with the rotation inverted and camera axes y up, z backward": pose.with_rotation((r @ UPWARD).T),
        "with y north and z up swapped": pose.with_rotation(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) @ r),
    }
    if pose.angles is not None and pose.turned is not None:
        for unit, factor in UNITS.items():
            found[f"with angles in {unit}"] = pose.with_rotation(pose.turned(pose.angles * factor))
    if pose.camera is not None and pose.camera.width != pose.camera.height:
        c = pose.camera
        swapped = Camera(c.height, c.width, c.fy, c.fx, c.cy, c.cx, c.distortion)
        found["with width and height swapped"] = replace(pose, camera=swapped)
    return found


def closest_camera(start: Camera, project: Callable[[Float64Array], Float64Array], place: str) -> Camera:
    """Return the camera whose pixels are closest to those of another lens model over the image of `start`.

    `project`: pixels (N, 2) of optical rays (N, 3). Raises PoseError if they differ by more than 0.5 px."""
    u, v = np.meshgrid(np.linspace(0, start.width - 1, 15), np.linspace(0, start.height - 1, 11))
    x, y = (u.ravel() - start.cx) / start.fx, (v.ravel() - start.cy) / start.fy
    rays = np.column_stack([x, y, np.ones_like(x)])
    pixels = project(rays)
    inside = np.isfinite(pixels).all(axis=1)
    inside &= (pixels > -1).all(axis=1) & (pixels < (start.width, start.height)).all(axis=1)
    if inside.sum() < 12:
        raise PoseError(f"{place}: its lens model shows hardly any ray inside {start.width} x {start.height} pixels")

    def camera(p: Float64Array) -> Camera:
        fx, fy, cx, cy, k1, k2, p1, p2, k3 = (float(value) for value in p)
        return replace(start, fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, k2, p1, p2, k3))

    def errors(p: Float64Array) -> Float64Array:
        return np.nan_to_num(camera(p).project(rays[inside]) - pixels[inside], nan=start.width).ravel()

    first = np.array([start.fx, start.fy, start.cx, start.cy, *start.distortion])
    solved = scipy.optimize.least_squares(errors, first, x_scale=[*first[:2]] * 2 + [0.1, 0.1, 0.01, 0.01, 0.1])
    worst = float(np.hypot(*solved.fun.reshape(-1, 2).T).max())
    if worst > MOST_LENS_ERROR:
        what = f"{place}: its lens model differs by {worst:.1f} px from k1, k2, p1, p2, k3 (Brown-Conrady)"
        raise PoseError(f"{what}; calibrate the lens again with that model")
    return camera(solved.x)
