"""Terrain, vegetation, a changed patch, a partly wrong prior map and towers for the trials of the fuel map."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ltm_core.base.types import BoolArray, Int16Array, UInt8Array
from ltm_core.fuel.life_form import NODATA, NONBURNABLE, LifeForm
from ltm_core.fuel.prior import FuelPrior
from ltm_core.fuel.votes import VoteCaster
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND
from ltm_lab.simulator import noise_fields

SUBCELLS = 3
"""Of the truth, a side of a fuel cell: cells are mixed."""
CODE_OF_FORM = {LifeForm.GRASS: 102, LifeForm.SHRUB: 145, LifeForm.TREE: 183, LifeForm.BARE: 99}
REACH = 3000.0
"""Metres out to which cameras vote."""
CAMERA = Camera.from_fov(640, 360, 62.0)
PATCH_CELLS = 14
"""Half the height of the patch that has changed, in cells."""
View = tuple[str, tuple[float, float, float], float, float]
"""Camera, position, azimuth, pitch."""


@dataclass(frozen=True, eq=False)
class World:
    """`truth`: (H, W) uint8 life forms of the cells, by majority of `fine` (SUBCELLS H, SUBCELLS W). `patch`: (H, W)
    bool, cells that were shrub, as the prior says too, and have become conifers."""

    dem: Dem
    geometry: GridGeometry
    fine: UInt8Array
    truth: UInt8Array
    patch: BoolArray
    prior: FuelPrior
    towers: tuple[tuple[float, float, float], ...]


def make_world(seed: int, prior_wrong: float, dem: Dem | None = None) -> World:
    """Terrain 6 km wide (or `dem`, in a map frame), its plants, a patch that the prior does not know, three towers.

    `prior_wrong`: share of the prior's cells that are of another form than it says, in patches."""
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
    codes = _wrong_in_patches(old, prior_wrong, rng)
    patch &= codes == CODE_OF_FORM[LifeForm.SHRUB]
    # Codes with as many subtypes as a real map has: that they come through unharmed is measured.
    subtype = rng.integers(0, 3, codes.shape)
    codes = np.where(np.isin(codes, NONBURNABLE), codes, codes + np.where(codes == 145, 2, 1) * (subtype == 0))
    prior = FuelPrior(codes.astype(np.int16), geometry)
    return World(dem, geometry, fine, truth, patch, prior, towers)


def majority_of(fine: UInt8Array) -> UInt8Array:
    """The commonest life form of each cell's subcells, the first of equals."""
    height, width = fine.shape
    blocks = fine.reshape(height // SUBCELLS, SUBCELLS, width // SUBCELLS, SUBCELLS)
    counts = np.stack([(blocks == form).sum(axis=(1, 3)) for form in LifeForm])
    return np.asarray(counts.argmax(axis=0) + 1, np.uint8)


def tower_views(towers: tuple[tuple[float, float, float], ...]) -> list[View]:
    """Each tower turns through all directions."""
    return [
        (f"tower_{k}", tower, azimuth + 20.0 * k, -10.0)
        for k, tower in enumerate(towers)
        for azimuth in (0.0, 60.0, 120.0, 180.0, 240.0, 300.0)
    ]


def _terrain(seed: int) -> Dem:
    geometry = GridGeometry(-3000.0, 3000.0, 10.0, 600, 600)
    xs, ys = geometry.to_map(np.zeros(600), np.arange(600))[0], geometry.to_map(np.arange(600), np.zeros(600))[1]
    height = 350 * noise_fields.fractal(xs, ys, 3200.0, seed, octaves=3) + 240 * noise_fields.fractal(
        xs, ys, 1500.0, seed + 5, octaves=6, ridged=True
    )
    return Dem((height + 600).astype(np.float32), geometry)


def _plants(geometry: GridGeometry, seed: int) -> UInt8Array:
    xs = geometry.to_map(np.zeros(geometry.width), np.arange(geometry.width))[0]
    ys = geometry.to_map(np.arange(geometry.height), np.zeros(geometry.height))[1]
    tree, grass, bare = (
        noise_fields.fractal(xs, ys, w, seed + k, octaves=5) for k, w in ((31, 900.0), (32, 700.0), (33, 400.0))
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
    dem: Dem, geometry: GridGeometry, towers: tuple[tuple[float, float, float], ...], plants: UInt8Array
) -> tuple[int, int]:
    """Where shrubs are most on ground that the towers see, the better placed the rather."""
    tracer = TerrainTracer(dem, possible=NOTHING_BEYOND)
    caster = VoteCaster(geometry, dem, np.array([False, True]), REACH, tracer.bend)
    ones = np.ones((CAMERA.height, CAMERA.width), np.uint8)
    turns = np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]) * np.radians(1.0) ** 2
    quality = np.zeros(geometry.shape)
    for name, position, azimuth, pitch in tower_views(towers):
        pose = Pose.from_angles(position, azimuth, pitch)
        ranges = tracer.trace(CAMERA, pose).range
        votes = caster.cast(ranges, CAMERA, pose, ones, 0, name, covariance=turns, along_axis=False)
        if votes.visibility is not None:
            quality[votes.rows, votes.cols] += votes.visibility.placement(geometry.resolution)
    shrubs = majority_of(plants) == LifeForm.SHRUB
    score = ndimage.uniform_filter(quality * shrubs, 2 * PATCH_CELLS, mode="constant")
    row, col = np.unravel_index(score.argmax(), score.shape)
    return int(row), int(col)


def _wrong_in_patches(forms: UInt8Array, share: float, rng: np.random.Generator) -> Int16Array:
    """Codes of life forms, that many of them another form's."""
    table = np.full(256, NODATA, np.int16)
    for form, code in CODE_OF_FORM.items():
        table[form] = code
    smooth = ndimage.gaussian_filter(rng.standard_normal(forms.shape), 3.0)
    other = rng.permuted(np.array([1, 2, 3], np.uint8))[(np.indices(forms.shape).sum(axis=0) // 25) % 3]
    wrong = (smooth > np.quantile(smooth, 1 - share)) if share > 0 else np.zeros(forms.shape, bool)
    return np.asarray(table[np.where(wrong & (forms != LifeForm.BARE), other, forms)], np.int16)
