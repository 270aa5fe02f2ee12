"""Trials of the fuel map: a country whose truth is known, cameras that see it through all that goes wrong.

Pixels are traced over the terrain with each frame's true pose to find what they show; the network's errors are drawn
for them; and they are voted with the pose that is believed. Nothing but that is simulated: votes, evidence and majority
are the system's own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import ndtr

from ltm_core.camera import Camera
from ltm_core.dem import Dem
from ltm_core.fuel.label_errors import LabelErrors
from ltm_core.fuel.life_form import NODATA, NONBURNABLE, LifeForm
from ltm_core.fuel.prior import FuelPrior
from ltm_core.fuel.votes import CellVotes, VoteCaster
from ltm_core.grid import GridGeometry
from ltm_core.pose import Pose
from ltm_core.simulator import noise
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import LabelSet

SUBCELLS = 3
"""Of the truth, a side of a fuel cell: cells are mixed."""
CODE_OF_FORM = {LifeForm.GRASS: 102, LifeForm.SHRUB: 145, LifeForm.TREE: 183, LifeForm.BARE: 99}
BEGIN_NS = 1_750_000_000 * 10**9
_REACH = 3000.0
_WIDTH, _HEIGHT, _HFOV_DEG = 640, 360, 62.0
PATCH_CELLS = 14
"""Half the height of the patch that has changed, in cells."""
_View = tuple[str, tuple[float, float, float], float, float, bool]
"""Camera, position, azimuth, pitch, and whether its labels are bad."""


@dataclass(frozen=True)
class Trial:
    """What goes wrong.

    `pose_deg`: root mean square of the rotation by which a pose is wrong, about any axis; half of its variance is the
    same in all frames of a view. `clumping`: of the network's errors, 0 each pixel for itself to 1 whole stands, in
    every frame alike. `network_error`: relative, by which the network differs in the field from what is known of it.
    `prior_wrong`: share of the prior's cells, in patches. `near`: one more camera low among the plants, with errors of
    its own, each third pixel taken for trees. `hours`: when each view is taken.
    """

    name: str
    pose_deg: float = 0.0
    clumping: float = 0.3
    network_error: float = 0.15
    prior_wrong: float = 0.05
    near: bool = False
    has_prior: bool = True
    hours: tuple[float, ...] = (0.0, 1.0)


TRIALS = (
    Trial("exact poses"),
    Trial("pose 1 deg", pose_deg=1.0),
    Trial("clumped label errors", clumping=0.7),
    Trial("a near camera dominates", near=True),
    Trial("outdated prior", prior_wrong=0.2),
    Trial("no prior", has_prior=False),
    Trial("all of it", pose_deg=1.0, clumping=0.6, near=True, prior_wrong=0.1),
    Trial("all of it, a week", pose_deg=1.0, clumping=0.6, near=True, prior_wrong=0.1, hours=(0, 1, 24, 48, 96, 168)),
)


@dataclass(frozen=True, eq=False)
class World:
    """`truth`: (H, W) uint8 life forms of the cells, by majority of `fine` (SUBCELLS H, SUBCELLS W). `patch`: (H, W)
    bool, cells that were shrub and have become conifers.
    """

    dem: Dem
    geometry: GridGeometry
    fine: NDArray[np.uint8]
    truth: NDArray[np.uint8]
    patch: NDArray[np.bool_]
    prior: FuelPrior
    towers: tuple[tuple[float, float, float], ...]
    noise: NDArray[np.float32] = field(repr=False)
    """Standard normal, smooth over a stand, on the grid of `fine`: where the network errs, whoever looks."""


def make_world(trial: Trial, seed: int, dem: Dem | None = None) -> World:
    """Terrain 6 km wide (or `dem`, in a map frame), its plants, a patch that the prior does not know, three towers."""
    rng = np.random.default_rng(seed)
    dem = _terrain(seed) if dem is None else dem
    x_min, y_min, x_max, y_max = dem.geometry.bounds
    middle_x, middle_y, half = (x_min + x_max) / 2, (y_min + y_max) / 2, min(x_max - x_min, y_max - y_min, 6000.0) / 2
    geometry = GridGeometry.snapped(
        (middle_x - half + 60, middle_y - half + 60, middle_x + half - 60, middle_y + half - 60), 30.0
    )
    fine_geometry = GridGeometry(
        geometry.x_min,
        geometry.y_max,
        geometry.resolution / SUBCELLS,
        geometry.width * SUBCELLS,
        geometry.height * SUBCELLS,
    )
    before = _plants(fine_geometry, seed)
    towers = _towers(dem, geometry)
    centre = _patch_centre(dem, geometry, towers, before)
    rows, cols = np.indices(geometry.shape)
    patch_area = np.hypot(rows - centre[0], (cols - centre[1]) / 1.3) < PATCH_CELLS
    old = majority_of(before)
    patch = patch_area & (old == LifeForm.SHRUB)
    grown = np.kron(patch, np.ones((SUBCELLS, SUBCELLS), bool)) & (rng.random(before.shape) < 0.92)
    fine = np.where(grown, np.uint8(LifeForm.TREE), before)
    truth = majority_of(fine)
    patch &= truth == LifeForm.TREE
    codes = _wrong_in_patches(old, trial.prior_wrong, rng)
    # Codes with as many subtypes as a real map has: that they come through unharmed is measured.
    subtype = rng.integers(0, 3, codes.shape)
    codes = np.where(np.isin(codes, NONBURNABLE), codes, codes + np.where(codes == 145, 2, 1) * (subtype == 0))
    prior = FuelPrior(codes.astype(np.int16), geometry)
    smooth = ndimage.gaussian_filter(rng.standard_normal(fine.shape), 4.0, mode="wrap")
    return World(dem, geometry, fine, truth, patch, prior, towers, (smooth / smooth.std()).astype(np.float32))


def majority_of(fine: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The commonest life form of each cell's subcells, the first of equals."""
    height, width = fine.shape
    blocks = fine.reshape(height // SUBCELLS, SUBCELLS, width // SUBCELLS, SUBCELLS)
    counts = np.stack([(blocks == form).sum(axis=(1, 3)) for form in LifeForm])
    return np.asarray(counts.argmax(axis=0) + 1, np.uint8)


def frames(world: World, trial: Trial, errors: LabelErrors, labels: LabelSet, seed: int) -> Iterator[CellVotes]:
    """The votes of all frames in order of time: each tower looks in four directions, twice or as often as it says."""
    rng = np.random.default_rng([seed, 77])
    tracer = TerrainTracer(world.dem)
    camera = Camera.from_fov(_WIDTH, _HEIGHT, _HFOV_DEG)
    caster = VoteCaster(world.geometry, world.dem, labels.votes_table[: len(labels)], _REACH, tracer.bend)
    views = _views(world, trial)
    each = trial.pose_deg / np.sqrt(3)  # of three angles, for a rotation of that much
    sigma = np.radians(each)
    covariance = np.diag([0.0, 0.0, 0.0, sigma**2, sigma**2, sigma**2]) if sigma else None
    lasting = rng.normal(0, each / np.sqrt(2), (len(views), 3))
    table = _network_in_the_field(errors, trial.network_error, rng)
    for hour in trial.hours:
        for view, (name, position, azimuth, pitch, bad) in enumerate(views):
            passing = rng.normal(0, each / np.sqrt(2), 3)
            turn = lasting[view] + passing
            true = Pose.from_angles(position, azimuth + turn[0], pitch + turn[1], turn[2])
            believed = Pose.from_angles(position, azimuth, pitch)
            shown, confidence = _labels(world, tracer, camera, true, table, trial.clumping, bad, rng)
            ranges = tracer.trace(camera, believed)
            yield caster.cast(
                ranges.range,
                camera,
                believed,
                shown,
                int(BEGIN_NS + hour * 3600e9),
                name,
                confidence,
                covariance,
                along_axis=False,
            )


def _labels(
    world: World,
    tracer: TerrainTracer,
    camera: Camera,
    pose: Pose,
    table: NDArray[np.float64],
    clumping: float,
    bad: bool,
    rng: np.random.Generator,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Label and confidence images of the true view, the network's errors drawn by a Gaussian copula: their shares are
    those of `table`, and neighbours err together.
    """
    points = tracer.trace(camera, pose).points()
    fine_cell = world.geometry.resolution / SUBCELLS
    geometry = GridGeometry(
        world.geometry.x_min, world.geometry.y_max, fine_cell, world.fine.shape[1], world.fine.shape[0]
    )
    seen = np.isfinite(points[..., 0])
    row, col = geometry.cell_of(np.where(seen, points[..., 0], 0), np.where(seen, points[..., 1], 0))
    seen &= geometry.contains(row, col)
    row, col = np.where(seen, row, 0), np.where(seen, col, 0)
    true = world.fine[row, col].astype(np.int64) - 1
    smooth = ndimage.gaussian_filter(rng.standard_normal(true.shape, np.float32), 6.0)
    own = (smooth / smooth.std(), rng.standard_normal(true.shape, np.float32))
    # Half of what is not the stand's is the frame's, in clumps; half is each pixel's.
    rest = np.sqrt((1 - clumping) / 2)
    chance = ndtr(np.sqrt(clumping) * world.noise[row, col] + rest * (own[0] + own[1]))
    order = np.argsort(-table, axis=1, kind="stable")  # the commonest answer first, so that errors share their places
    cumulative = np.cumsum(np.take_along_axis(table, order, axis=1), axis=1)
    rank = (chance[..., None] > cumulative[true]).sum(axis=-1)
    shown = np.take_along_axis(order[true], np.minimum(rank, table.shape[1] - 1)[..., None], axis=-1)[..., 0]
    if bad:
        shown = np.where(smooth > 0.43 * smooth.std(), LifeForm.TREE - 1, shown)
    confidence = np.clip(0.95 - 0.5 * chance + 0.05 * own[1], 0.3, 1.0)
    image = np.where(seen, shown + 1, 0).astype(np.uint8)
    return image, (confidence * 255).astype(np.uint8)


def _network_in_the_field(errors: LabelErrors, relative: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """(FORMS, FORMS) shares that differ from what is known of the network."""
    table = np.where(np.isnan(errors.shares), np.eye(len(errors.shares)), errors.shares)
    wrong = table * np.exp(rng.normal(0, 2 * relative, table.shape))
    np.fill_diagonal(wrong, np.diagonal(table) * np.exp(rng.normal(0, relative / 2, len(table))))
    return np.asarray(wrong / wrong.sum(axis=1, keepdims=True))


def _tower_views(towers: tuple[tuple[float, float, float], ...]) -> list[_View]:
    return [
        (f"tower_{k}", tower, azimuth + 20.0 * k, -10.0, False)
        for k, tower in enumerate(towers)
        for azimuth in (0.0, 60.0, 120.0, 180.0, 240.0, 300.0)
    ]


def _views(world: World, trial: Trial) -> list[_View]:
    views = _tower_views(world.towers)
    if trial.near:
        x, y, _ = world.towers[0]
        place = (x + 400.0, y - 250.0)
        height = float(world.dem.elevation_at(*place)) + 6.0
        views += [("near", (*place, height), azimuth, -4.0, True) for azimuth in (45.0, 225.0)]
    return views


def _terrain(seed: int) -> Dem:
    geometry = GridGeometry(-3000.0, 3000.0, 10.0, 600, 600)
    xs, ys = geometry.to_map(np.zeros(600), np.arange(600))[0], geometry.to_map(np.arange(600), np.zeros(600))[1]
    height = 350 * noise.fractal(xs, ys, 3200.0, seed, octaves=3) + 240 * noise.fractal(
        xs, ys, 1500.0, seed + 5, octaves=6, ridged=True
    )
    return Dem((height + 600).astype(np.float32), geometry)


def _plants(geometry: GridGeometry, seed: int) -> NDArray[np.uint8]:
    xs = geometry.to_map(np.zeros(geometry.width), np.arange(geometry.width))[0]
    ys = geometry.to_map(np.arange(geometry.height), np.zeros(geometry.height))[1]
    tree, grass, bare = (
        noise.fractal(xs, ys, w, seed + k, octaves=5) for k, w in ((31, 900.0), (32, 700.0), (33, 400.0))
    )
    result = np.full(geometry.shape, LifeForm.SHRUB, np.uint8)
    result[grass > np.quantile(grass, 0.72)] = LifeForm.GRASS
    result[tree > np.quantile(tree, 0.75)] = LifeForm.TREE
    result[bare > np.quantile(bare, 0.96)] = LifeForm.BARE
    return result


def _towers(dem: Dem, geometry: GridGeometry) -> tuple[tuple[float, float, float], ...]:
    """Three of the highest places, at least 1.2 km from each other."""
    rows, cols = np.indices(geometry.shape)
    x, y = geometry.to_map(rows, cols)
    z = dem.elevation_at(x, y)
    inner = (np.minimum(rows, geometry.height - 1 - rows) > 20) & (np.minimum(cols, geometry.width - 1 - cols) > 20)
    free = inner & np.isfinite(z)
    towers = []
    for _ in range(3):
        best = np.unravel_index(np.where(free, z, -np.inf).argmax(), z.shape)
        towers.append((float(x[best]), float(y[best]), float(z[best]) + 20.0))
        free &= np.hypot(x - x[best], y - y[best]) > 1200.0
    return tuple(towers)


def _patch_centre(
    dem: Dem, geometry: GridGeometry, towers: tuple[tuple[float, float, float], ...], plants: NDArray[np.uint8]
) -> tuple[int, int]:
    """Where shrubs are most on ground that the towers see, the better placed the rather."""
    tracer = TerrainTracer(dem)
    caster = VoteCaster(geometry, dem, np.array([False, True]), _REACH, tracer.bend)
    camera = Camera.from_fov(_WIDTH, _HEIGHT, _HFOV_DEG)
    ones = np.ones((_HEIGHT, _WIDTH), np.uint8)
    turns = np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]) * np.radians(1.0) ** 2
    quality = np.zeros(geometry.shape)
    for name, position, azimuth, pitch, _ in _tower_views(towers):
        pose = Pose.from_angles(position, azimuth, pitch)
        ranges = tracer.trace(camera, pose).range
        votes = caster.cast(ranges, camera, pose, ones, 0, name, covariance=turns, along_axis=False)
        if votes.sighting is not None:
            quality[votes.rows, votes.cols] += votes.sighting.placement(geometry.resolution)
    shrubs = majority_of(plants) == LifeForm.SHRUB
    score = ndimage.uniform_filter(quality * shrubs, 2 * PATCH_CELLS, mode="constant")
    row, col = np.unravel_index(score.argmax(), score.shape)
    return int(row), int(col)


def _wrong_in_patches(forms: NDArray[np.uint8], share: float, rng: np.random.Generator) -> NDArray[np.int16]:
    """Codes of life forms, that many of them another form's."""
    table = np.full(256, NODATA, np.int16)
    for form, code in CODE_OF_FORM.items():
        table[form] = code
    smooth = ndimage.gaussian_filter(rng.standard_normal(forms.shape), 3.0)
    other = rng.permuted(np.array([1, 2, 3], np.uint8))[(np.indices(forms.shape).sum(axis=0) // 25) % 3]
    wrong = (smooth > np.quantile(smooth, 1 - share)) if share > 0 else np.zeros(forms.shape, bool)
    return np.asarray(table[np.where(wrong & (forms != LifeForm.BARE), other, forms)], np.int16)
