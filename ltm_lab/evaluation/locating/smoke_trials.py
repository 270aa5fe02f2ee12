"""Geometric smoke as cameras see it: a leaning plume over a place of the true ground, its lowest visible part by lines
of sight against that ground, and what a detector or a person marks of it. No picture is rendered."""

import math
from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import RegionError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, pose_covariance
from ltm_core.locating.region import marked_box, marked_pixel
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sighting import Sighting
from ltm_core.visibility.point_visibility import PointVisibility, in_image, project

CAMERA = Camera.from_fov(1920, 1080, 60.0)
LEAST_HEIGHT = 15.0
"""Metres of a plume that must be seen, and pixels: a smaller one is not noticed."""
LEAST_PIXELS = 8.0
_SEEN = 0.5
"""Metres below a line of sight that count as seen."""
_BETWEEN = 17
"""Heights at which the lowest visible part is looked for between two samples of the axis."""


@dataclass(frozen=True)
class PoseErrors:
    """Sigmas of what a stated pose has wrong, and what its covariance says: degrees of each angle, metres."""

    angle_deg: float
    position: float = 0.5


@dataclass(frozen=True, eq=False)
class Plume:
    """`foot`: (3,) on the true ground. `lean`: (2,) horizontal drift a metre of height. `height`: above the foot."""

    foot: Float64Array
    lean: Float64Array
    height: float

    def axis(self, count: int = 80) -> tuple[Float64Array, Float64Array]:
        """Heights above the foot, (count,), and the axis there, (count, 3)."""
        heights = np.concatenate([[0.0], np.geomspace(0.5, self.height, count - 1)])
        return heights, self.at(heights)

    def at(self, heights: Float64Array) -> Float64Array:
        """The axis at heights above the foot (N,), (N, 3)."""
        return np.asarray(self.foot + heights[:, None] * np.array([self.lean[0], self.lean[1], 1.0]), np.float64)


@dataclass(frozen=True, eq=False)
class SeenPlume:
    """What a tower sees of a plume. `hidden`: metres of it below the line of sight; 0 where its foot is seen."""

    plume: Plume
    tower: Float64Array
    hidden: float
    seen: Float64Array
    """(N, 3) the axis above that."""
    widths: Float64Array
    """(N,) metres, half."""

    @property
    def range(self) -> float:
        return math.hypot(*(self.plume.foot[:2] - self.tower[:2]).tolist())

    @property
    def bearing(self) -> float:
        """Radians, from the tower."""
        x, y = self.plume.foot[:2] - self.tower[:2]
        return math.atan2(float(x), float(y))


def random_plume(rng: np.random.Generator, place: Float64Array) -> Plume:
    """Median height 120 m, lognormal with 0.6; leaning by up to 35 degrees in any direction."""
    angle, size = rng.uniform(0, 2 * np.pi), 0.7 * math.sqrt(rng.uniform())
    lean = size * np.array([math.cos(angle), math.sin(angle)])
    return Plume(place, lean, 120.0 * math.exp(0.6 * rng.standard_normal()))


def seen_plume(sight: PointVisibility, plume: Plume, tower: Float64Array) -> SeenPlume | None:
    """None where too little of it is seen to be noticed. `sight`: over the true ground."""
    heights, points = plume.axis()
    lifts, _ = sight.lifts(tower, points)
    shown = np.flatnonzero(lifts <= _SEEN)
    if not len(shown):
        return None
    first = int(shown[0])
    if first > 0:
        # The axis is sampled the more coarsely the higher it is: by metres, which are pixels of a mark.
        between = np.linspace(heights[first - 1], heights[first], _BETWEEN)[1:]
        finer = plume.at(between)
        lowest = int(np.flatnonzero(sight.lifts(tower, finer)[0] <= _SEEN)[0])
        heights = np.concatenate([between[lowest : lowest + 1], heights[first:]])
        points = np.concatenate([finer[lowest : lowest + 1], points[first:]])
        first = 0
    if plume.height - heights[first] < LEAST_HEIGHT:
        return None
    return SeenPlume(plume, tower, float(heights[first]), points[first:], 6.0 + 0.12 * heights[first:])


def sighting(
    rng: np.random.Generator,
    name: str,
    seen: SeenPlume,
    bend: float,
    errors: PoseErrors,
    config: LocatingConfig,
    boxed: bool,
    turned_deg: float = 0.0,
    offsets: Float64Array | None = None,
) -> Sighting | None:
    """What a camera that shows the plume reports: a box around what is seen of it, or a click on its lowest part, with
    a pose that is wrong by `errors` and, unknown to all, turned by `turned_deg`. `offsets`: (6,) sigmas by which the
    pose is wrong, position and angles, where a camera has the same ones each time; else they are drawn.

    None where it does not fit the picture."""
    azimuth = math.degrees(seen.bearing) + rng.uniform(-24, 24)
    true = Pose.from_angles(seen.tower, azimuth, rng.uniform(-5, 0), 0.5 * rng.standard_normal())
    pixels = project(CAMERA, true, seen.seen, bend)
    radius = CAMERA.fx * seen.widths / np.linalg.norm(seen.seen - seen.tower, axis=1)
    if not in_image(CAMERA, pixels[:1])[0] or pixels[0, 1] - pixels[:, 1].min() < LEAST_PIXELS:
        return None
    if boxed:
        left, right = (pixels[:, 0] - radius).min(), (pixels[:, 0] + radius).max()
        top, bottom = pixels[:, 1].min(), pixels[:, 1].max()
        size = np.array([right - left, bottom - top])
        noise = np.maximum(1.0, 0.03 * size)
        left, right = left + noise[0] * rng.standard_normal(), right + noise[0] * rng.standard_normal()
        top, bottom = top + noise[1] * rng.standard_normal(), bottom + noise[1] * rng.standard_normal()
        corners = (min(left, right), min(top, bottom), max(left, right), max(top, bottom))
    else:
        corners = tuple(pixels[0] + 1.5 * rng.standard_normal(2))
    off = rng.standard_normal(6) if offsets is None else offsets
    stated = Pose.from_angles(
        seen.tower + errors.position * off[:3],
        true.angles_deg[0] + errors.angle_deg * off[3] + turned_deg,
        true.angles_deg[1] + errors.angle_deg * off[4],
        true.angles_deg[2] + errors.angle_deg * off[5],
    )
    a = errors.angle_deg
    covariance = pose_covariance(stated, errors.position, errors.position, a, a, a)
    try:
        if boxed:
            mark = marked_box(CAMERA, corners, config.pixel_sigma, config.box_sigma, True)
        else:
            mark = marked_pixel(CAMERA, corners, config.pixel_sigma)
    except RegionError:
        return None
    return Sighting(name, CAMERA, stated, covariance, mark)
