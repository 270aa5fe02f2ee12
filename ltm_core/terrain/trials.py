"""Exact scenes to score the surface map on: hillsides whose surface before and after is known to the cell.

No renderer is needed: what two towers measure is traced on the true surface, with the noise of a fused depth image;
what the map is given is the surface of before.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ltm_core.camera import Camera
from ltm_core.dem import Dem
from ltm_core.errors import ConfigError
from ltm_core.grid import GridGeometry
from ltm_core.pose import Pose
from ltm_core.terrain.observation import DepthFrame
from ltm_core.tracing import TerrainTracer

Heights = NDArray[np.float32]

SIZE = (820, 1000)
"""Rows and columns, cells of 1 m."""
GEOMETRY = GridGeometry(0.0, float(SIZE[0]), 1.0, SIZE[1], SIZE[0])
CENTRE = (500.0, 560.0)
"""(x, y) of what happens; the towers stand 500 m from it."""
TOWERS = {"west": (250.0, 127.0), "east": (750.0, 127.0)}
MAST = 25.0
BEGIN_NS = 1_700_000_000_000_000_000
HOUR_NS = 3_600_000_000_000
YEARS = 10.0

SCENES = (
    "unchanged", "landslide", "felled", "growth", "burn", "conversion", "cut", "coarse", "shifted",
)  # fmt: skip


@dataclass(frozen=True)
class Noise:
    """Of one depth image: sigma = `constant` + `share` x range, half of its variance with a length of `correlation`
    pixels, the rest by pixel; `lasting`: the part of the correlated noise that all images of one camera have alike.
    """

    constant: float = 0.3
    share: float = 0.01
    correlation: float = 12.0
    lasting: float = 0.3


@dataclass(frozen=True)
class Conditions:
    """`pose_error_deg`: sigma of each of a frame's three angles, which the frame's covariance states. `occluded`: share
    of the image that something nearer hides, elsewhere in every frame. `looks`: images of each tower, two hours apart.
    """

    pose_error_deg: float = 0.0
    occluded: float = 0.0
    looks: int = 3
    noise: Noise = Noise()
    width: int = 1920
    height: int = 1080
    hfov_deg: float = 54.0
    seed: int = 1


@dataclass(frozen=True, eq=False)
class Trial:
    """`bare`, `given`: bare earth and surface as the map gets them. `true_before`, `true_now`: the real surface. Change
    is what `true_now` differs from `given`.
    """

    name: str
    bare: Dem
    given: Dem
    true_before: Dem
    true_now: Dem


@dataclass(frozen=True, eq=False)
class _Trees:
    """Stems: x, y, height, crown radius, (N,) each."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    height: NDArray[np.float64]
    radius: NDArray[np.float64]

    def where(self, kept: NDArray[np.bool_]) -> _Trees:
        return _Trees(self.x[kept], self.y[kept], self.height[kept], self.radius[kept])

    def joined(self, other: _Trees) -> _Trees:
        pairs = ((self.x, other.x), (self.y, other.y), (self.height, other.height), (self.radius, other.radius))
        return _Trees(*(np.concatenate(pair) for pair in pairs))


def trial(name: str, seed: int = 1) -> Trial:
    """One of SCENES. Raises ConfigError for another name."""
    if name not in SCENES:
        raise ConfigError(f"no scene {name!r}; there are {', '.join(SCENES)}")
    rng = np.random.default_rng(seed)
    bare = _hillside(rng)
    trees, shrubs = _stands(rng), _shrubs(rng)
    before = bare + np.maximum(_canopy(trees), shrubs)
    x, y = GEOMETRY.to_map(*np.mgrid[0 : SIZE[0], 0 : SIZE[1]])
    dx, dy = x - CENTRE[0], y - CENTRE[1]
    tx, ty = trees.x - CENTRE[0], trees.y - CENTRE[1]
    now, given_bare, given = before, bare, before
    if name == "landslide":
        inside = (np.abs(dx) <= 40) & (np.abs(dy) <= 40)
        clear = _canopy(trees.where((np.abs(tx) > 45) | (np.abs(ty) > 45)))
        open_ground = np.where(inside, 0.0, np.maximum(clear, shrubs))
        given = before = bare + open_ground
        edge = np.clip((25.0 - np.maximum(np.abs(dx), np.abs(dy))) / 2.0 + 0.5, 0.0, 1.0)
        now = before - 3.0 * edge
    elif name == "felled":
        stand = _planted(rng, (-35.0, 35.0), (-35.0, 35.0), 12.0)
        others = trees.where((np.abs(tx) > 45) | (np.abs(ty) > 45))
        given = before = bare + np.maximum(_canopy(others.joined(stand)), shrubs * (np.maximum(abs(dx), abs(dy)) > 40))
        now = bare + np.maximum(_canopy(others), shrubs * (np.maximum(abs(dx), abs(dy)) > 40))
    elif name == "growth":
        older = replace(trees, height=trees.height + 0.4 * YEARS, radius=trees.radius * 1.15)
        now = bare + np.maximum(_canopy(older), shrubs)
    elif name == "burn":
        burnt = np.hypot(tx / 110, ty / 80) < 1
        left = trees.where(~burnt | (rng.random(len(tx)) < 0.25))
        now = bare + np.maximum(_canopy(left), shrubs * (np.hypot(dx / 110, dy / 80) >= 1))
    elif name == "conversion":
        young = _planted(rng, (-90.0, 90.0), (-60.0, 60.0), 7.0)
        now = np.maximum(before, bare + _canopy(young))
    elif name == "cut":
        stand = _planted(rng, (-120.0, 120.0), (-60.0, 60.0), 12.0)
        lane = np.abs(stand.y - CENTRE[1] - 0.2 * (stand.x - CENTRE[0])) < 12
        others = trees.where((np.abs(tx) > 125) | (np.abs(ty) > 65))
        given = before = bare + np.maximum(_canopy(others.joined(stand)), shrubs)
        now = bare + np.maximum(_canopy(others.joined(stand.where(~lane))), shrubs)
    elif name == "coarse":
        given_bare, given = _coarse(bare, 10), _coarse(bare, 10) + (before - bare)
    elif name == "shifted":
        given_bare, given = (np.asarray(ndimage.shift(a, (1.0, -2.0), order=1, mode="nearest")) for a in (bare, before))
    as_dem = [Dem(np.asarray(a, np.float32), GEOMETRY) for a in (given_bare, given, before, now)]
    return Trial(name, *as_dem)


def frames(scene: Trial, conditions: Conditions) -> Iterator[DepthFrame]:
    """What the towers measure of the surface as it is now."""
    yield from frames_of(scene.true_now, conditions, BEGIN_NS)


def frames_of(surface: Dem, conditions: Conditions, begin_ns: int) -> Iterator[DepthFrame]:
    """What the towers measure of a surface, from `begin_ns` on."""
    rng = np.random.default_rng((conditions.seed, begin_ns // HOUR_NS))
    camera = Camera.from_fov(conditions.width, conditions.height, conditions.hfov_deg)
    tracer = TerrainTracer(surface)
    lasting = {name: _correlated(rng, camera, conditions.noise.correlation) for name in TOWERS}
    for look in range(conditions.looks):
        for number, name in enumerate(TOWERS):
            true = tower_pose(name, surface)
            traced = tracer.trace(camera, true)
            yield _measured(
                traced.depth(), camera, true, lasting[name], rng, conditions, name,
                begin_ns + look * 2 * HOUR_NS + number * 1_200_000_000_000,
            )  # fmt: skip


def tower_pose(name: str, surface: Dem) -> Pose:
    """A tower's true pose: MAST metres over the ground, towards CENTRE."""
    x, y = TOWERS[name]
    z = float(surface.elevation_at(x, y)) + MAST
    dx, dy = CENTRE[0] - x, CENTRE[1] - y
    target = float(surface.elevation_at(*CENTRE))
    pitch = math.degrees(math.atan2(target - z, math.hypot(dx, dy)))
    return Pose.from_angles((x, y, z), math.degrees(math.atan2(dx, dy)), pitch, 0.8)


def _measured(
    depth: Heights,
    camera: Camera,
    true: Pose,
    lasting: Heights,
    rng: np.random.Generator,
    conditions: Conditions,
    name: str,
    stamp_ns: int,
) -> DepthFrame:
    noise = conditions.noise
    with np.errstate(invalid="ignore"):
        sigma = (noise.constant + noise.share * np.where(np.isfinite(depth), depth, 0)).astype(np.float32)
    mixed = math.sqrt(noise.lasting) * lasting + math.sqrt(1 - noise.lasting) * _correlated(
        rng, camera, noise.correlation
    )
    error = math.sqrt(0.5) * (mixed + rng.standard_normal(depth.shape, np.float32))
    measured = depth + sigma * error
    if conditions.occluded > 0:
        blobs = _correlated(rng, camera, 60.0)
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


def _correlated(rng: np.random.Generator, camera: Camera, length: float) -> Heights:
    """Unit noise of that correlation length in pixels, made at a third of it."""
    step = max(1, int(length / 3))
    small = rng.standard_normal((camera.height // step + 3, camera.width // step + 3))
    blurred = ndimage.gaussian_filter(small, length / step, mode="wrap")
    whole = ndimage.zoom(blurred / blurred.std(), step, order=1)[: camera.height, : camera.width]
    return np.asarray(whole, np.float32)


def _hillside(rng: np.random.Generator) -> NDArray[np.float64]:
    """A slope that faces the towers, with spurs and gullies; gentle where the towers stand."""
    row, col = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    _, y = GEOMETRY.to_map(row, col)
    height = 900 + 0.34 * np.maximum(y - 230.0, 0) - 0.06 * np.minimum(y, 230.0)
    for sigma, amount in ((70.0, 9.0), (22.0, 1.6), (7.0, 0.35)):
        rough = ndimage.gaussian_filter(rng.standard_normal(SIZE), sigma, mode="reflect")
        height = height + amount * rough / rough.std()
    return np.asarray(height, np.float64)


def _planted(rng: np.random.Generator, east: tuple[float, float], north: tuple[float, float], height: float) -> _Trees:
    """A stand about CENTRE with a stem every 4 m or so."""
    x, y = np.meshgrid(np.arange(*east, 4.0), np.arange(*north, 4.0))
    x, y = (CENTRE[i] + a.ravel() + rng.uniform(-1.2, 1.2, a.size) for i, a in enumerate((x, y)))
    tall = rng.normal(height, height / 10, x.size).clip(height / 2)
    return _Trees(x, y, tall, 0.9 + 0.1 * tall)


def _stands(rng: np.random.Generator) -> _Trees:
    """Woods on about a third of the slope, none near the towers."""
    wooded = ndimage.gaussian_filter(rng.standard_normal(SIZE), 35, mode="reflect")
    wooded = wooded > np.quantile(wooded, 0.62)
    x, y = np.meshgrid(np.arange(3.0, SIZE[1] - 3, 4.5), np.arange(260.0, SIZE[0] - 3, 4.5))
    x, y = (a.ravel() + rng.uniform(-1.5, 1.5, a.size) for a in (x, y))
    row, col = GEOMETRY.cell_of(x, y)
    kept = wooded[row.clip(0, SIZE[0] - 1), col.clip(0, SIZE[1] - 1)]
    tall = rng.normal(11.0, 2.0, x.size).clip(4)
    return _Trees(x, y, tall, 0.9 + 0.12 * tall).where(kept)


def _shrubs(rng: np.random.Generator) -> NDArray[np.float64]:
    """Brush up to 2 m, in patches."""
    patch = ndimage.gaussian_filter(rng.standard_normal(SIZE), 18, mode="reflect")
    lump = ndimage.gaussian_filter(rng.standard_normal(SIZE), 1.5, mode="reflect")
    height = 1.2 + 0.5 * lump / lump.std()
    return np.asarray(np.where(patch > np.quantile(patch, 0.7), height.clip(0, 2.0), 0.0))


def _canopy(trees: _Trees) -> NDArray[np.float64]:
    """Height of the crowns over the ground, (H, W): paraboloids on their stems."""
    canopy = np.zeros(SIZE)
    rows, cols = GEOMETRY.to_grid(trees.x, trees.y)
    for row, col, height, radius in zip(rows, cols, trees.height, trees.radius, strict=True):
        reach = math.ceil(radius)
        r0, r1 = max(int(row) - reach, 0), min(int(row) + reach + 2, SIZE[0])
        c0, c1 = max(int(col) - reach, 0), min(int(col) + reach + 2, SIZE[1])
        if r0 >= r1 or c0 >= c1:
            continue
        r, c = np.mgrid[r0:r1, c0:c1]
        far = ((r - row) ** 2 + (c - col) ** 2) / radius**2
        crown = np.where(far < 1, height * (1 - 0.55 * far), 0.0)
        canopy[r0:r1, c0:c1] = np.maximum(canopy[r0:r1, c0:c1], crown)
    return canopy


def _coarse(heights: NDArray[np.float64], factor: int) -> NDArray[np.float64]:
    """As a raster `factor` times as coarse has it, bilinear between its cells."""
    rows, cols = SIZE[0] // factor, SIZE[1] // factor
    means = heights[: rows * factor, : cols * factor].reshape(rows, factor, cols, factor).mean(axis=(1, 3))
    row = (np.arange(SIZE[0]) + 0.5) / factor - 0.5
    col = (np.arange(SIZE[1]) + 0.5) / factor - 0.5
    return np.asarray(
        ndimage.map_coordinates(means, np.meshgrid(row, col, indexing="ij"), order=1, mode="nearest"), np.float64
    )
