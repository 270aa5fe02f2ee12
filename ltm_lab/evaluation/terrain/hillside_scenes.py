"""Exact hillside scenes for the surface map: the true surface before and after is known for each cell.

No renderer is needed: what two towers measure is traced on the true surface, with the noise of a fused depth image; the
map is given the surface of before."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import Float32Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.surface.observation import DepthFrame
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND
from ltm_lab.evaluation.terrain.hillside_ground import (
    CENTRE,
    GEOMETRY,
    SIZE,
    TOWERS,
    canopy,
    coarse,
    overlooked_hillside,
    planted,
    shrubs,
    stands,
    tower_pose,
)

BEGIN_NS = 1_700_000_000_000_000_000
HOUR_NS = 3_600_000_000_000
YEARS = 10.0
_OCCLUSION_PX = 60.0
"""Pixels of the whole image: the length of what stands before the view."""

SCENES = (
    "unchanged", "landslide", "felled", "growth", "burn", "conversion", "cut", "coarse", "shifted",
)  # fmt: skip


@dataclass(frozen=True)
class Noise:
    """Of one depth image: sigma = `constant` + `share` x range, half of its variance with a length of `correlation`
    pixels, the rest by pixel; `lasting`: the part of the correlated noise that all images of one camera have alike."""

    constant: float = 0.3
    share: float = 0.01
    correlation: float = 12.0
    lasting: float = 0.3

    @property
    def repeats(self) -> float:
        """Of the variance, what all images of one camera have alike: a surface map is told of it, as of sigma."""
        return 0.5 * self.lasting


@dataclass(frozen=True)
class SceneConditions:
    """`pose_error_deg`: sigma of each of a frame's three angles, which the frame's covariance states. `occluded`: share
    of the image that something nearer hides, elsewhere in every frame. `looks`: images of each tower, two hours apart.
    `width`, `height`: of the camera; only every `pixel_step`-th row and column is made, since the map takes no others.
    `seed`: of the ground, what stands on it, the poses' errors and the noise."""

    pose_error_deg: float = 0.0
    occluded: float = 0.0
    looks: int = 3
    noise: Noise = Noise()
    width: int = 1920
    height: int = 1080
    pixel_step: int = 2
    hfov_deg: float = 54.0
    seed: int = 1


@dataclass(frozen=True, eq=False)
class HillsideScene:
    """`bare`, `given`: bare earth and surface as the map gets them. `true_before`, `true_now`: the real surface. Change
    is what `true_now` differs from `given`."""

    name: str
    bare: Dem
    given: Dem
    true_before: Dem
    true_now: Dem


def trial(name: str, seed: int = 1) -> HillsideScene:
    """One of SCENES. Raises ConfigError for another name."""
    if name not in SCENES:
        raise ConfigError(f"no scene {name!r}; there are {', '.join(SCENES)}")
    rng = np.random.default_rng(seed)
    bare = overlooked_hillside(rng)
    trees, brush = stands(rng), shrubs(rng)
    before = bare + np.maximum(canopy(trees), brush)
    x, y = GEOMETRY.to_map(*np.mgrid[0 : SIZE[0], 0 : SIZE[1]])
    dx, dy = x - CENTRE[0], y - CENTRE[1]
    tx, ty = trees.x - CENTRE[0], trees.y - CENTRE[1]
    now, given_bare, given = before, bare, before
    if name == "landslide":
        inside = (np.abs(dx) <= 40) & (np.abs(dy) <= 40)
        clear = canopy(trees.where((np.abs(tx) > 45) | (np.abs(ty) > 45)))
        open_ground = np.where(inside, 0.0, np.maximum(clear, brush))
        given = before = bare + open_ground
        edge = np.clip((25.0 - np.maximum(np.abs(dx), np.abs(dy))) / 2.0 + 0.5, 0.0, 1.0)
        now = before - 3.0 * edge
    elif name == "felled":
        stand = planted(rng, (-35.0, 35.0), (-35.0, 35.0), 12.0)
        others = trees.where((np.abs(tx) > 45) | (np.abs(ty) > 45))
        given = before = bare + np.maximum(canopy(others.joined(stand)), brush * (np.maximum(abs(dx), abs(dy)) > 40))
        now = bare + np.maximum(canopy(others), brush * (np.maximum(abs(dx), abs(dy)) > 40))
    elif name == "growth":
        older = replace(trees, height=trees.height + 0.4 * YEARS, radius=trees.radius * 1.15)
        now = bare + np.maximum(canopy(older), brush)
    elif name == "burn":
        burnt = np.hypot(tx / 110, ty / 80) < 1
        left = trees.where(~burnt | (rng.random(len(tx)) < 0.25))
        now = bare + np.maximum(canopy(left), brush * (np.hypot(dx / 110, dy / 80) >= 1))
    elif name == "conversion":
        young = planted(rng, (-90.0, 90.0), (-60.0, 60.0), 7.0)
        now = np.maximum(before, bare + canopy(young))
    elif name == "cut":
        stand = planted(rng, (-120.0, 120.0), (-60.0, 60.0), 12.0)
        lane = np.abs(stand.y - CENTRE[1] - 0.2 * (stand.x - CENTRE[0])) < 12
        others = trees.where((np.abs(tx) > 125) | (np.abs(ty) > 65))
        given = before = bare + np.maximum(canopy(others.joined(stand)), brush)
        now = bare + np.maximum(canopy(others.joined(stand.where(~lane))), brush)
    elif name == "coarse":
        given_bare, given = coarse(bare, 10), coarse(bare, 10) + (before - bare)
    elif name == "shifted":
        given_bare, given = (np.asarray(ndimage.shift(a, (1.0, -2.0), order=1, mode="nearest")) for a in (bare, before))
    as_dem = [Dem(np.asarray(a, np.float32), GEOMETRY) for a in (given_bare, given, before, now)]
    return HillsideScene(name, *as_dem)


def frames(scene: HillsideScene, conditions: SceneConditions) -> Iterator[DepthFrame]:
    """What the towers measure of the surface as it is now."""
    yield from frames_of(scene.true_now, conditions, BEGIN_NS)


def frames_of(surface: Dem, conditions: SceneConditions, begin_ns: int) -> Iterator[DepthFrame]:
    """What the towers measure of a surface, from `begin_ns` on."""
    rng = np.random.default_rng((conditions.seed, begin_ns // HOUR_NS))
    camera = Camera.from_fov(conditions.width, conditions.height, conditions.hfov_deg).scaled(conditions.pixel_step)
    tracer = TerrainTracer(surface, possible=NOTHING_BEYOND)
    length = conditions.noise.correlation / conditions.pixel_step
    lasting = {name: _correlated(rng, camera, length) for name in TOWERS}
    for look in range(conditions.looks):
        for number, name in enumerate(TOWERS):
            true = tower_pose(name, surface)
            traced = tracer.trace(camera, true)
            yield _measured(
                traced.depth(), camera, true, lasting[name], rng, conditions, name,
                begin_ns + look * 2 * HOUR_NS + number * 1_200_000_000_000,
            )  # fmt: skip


def _measured(
    depth: Float32Array,
    camera: Camera,
    true: Pose,
    lasting: Float32Array,
    rng: np.random.Generator,
    conditions: SceneConditions,
    name: str,
    stamp_ns: int,
) -> DepthFrame:
    noise = conditions.noise
    with np.errstate(invalid="ignore"):
        sigma = (noise.constant + noise.share * np.where(np.isfinite(depth), depth, 0)).astype(np.float32)
    own = _correlated(rng, camera, noise.correlation / conditions.pixel_step)
    mixed = math.sqrt(noise.lasting) * lasting + math.sqrt(1 - noise.lasting) * own
    error = math.sqrt(0.5) * (mixed + rng.standard_normal(depth.shape, np.float32))
    measured = depth + sigma * error
    if conditions.occluded > 0:
        blobs = _correlated(rng, camera, _OCCLUSION_PX / conditions.pixel_step)
        hidden = blobs > np.quantile(blobs, 1 - conditions.occluded)
        nearer = rng.uniform(0.2, 0.7) * np.where(np.isfinite(depth), depth, 600.0)
        measured = np.where(hidden, nearer, measured)
        sigma = np.where(hidden, noise.constant + noise.share * nearer, sigma).astype(np.float32)
    told, covariance = true, np.diag([1e-6] * 3 + [1e-12] * 3)
    if conditions.pose_error_deg > 0:
        azimuth, pitch, roll = np.asarray(true.angles_deg) + rng.normal(0, conditions.pose_error_deg, 3)
        told = Pose.from_angles(true.position, float(azimuth), float(pitch), float(roll))
        covariance = np.diag([1e-6] * 3 + [math.radians(conditions.pose_error_deg) ** 2] * 3)
    informs = np.ones(depth.shape, np.bool_)
    return DepthFrame(measured.astype(np.float32), sigma, informs, camera, told, stamp_ns, name, covariance)


def _correlated(rng: np.random.Generator, camera: Camera, length: float) -> Float32Array:
    """Unit noise of that correlation length in pixels, made at a third of it."""
    step = max(1, int(length / 3))
    small = rng.standard_normal((camera.height // step + 3, camera.width // step + 3))
    blurred = ndimage.gaussian_filter(small, length / step, mode="wrap")
    whole = ndimage.zoom(blurred / blurred.std(), step, order=1)[: camera.height, : camera.width]
    return np.asarray(whole, np.float32)
