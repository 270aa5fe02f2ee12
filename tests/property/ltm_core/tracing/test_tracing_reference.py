"""The fast tracer against the every-cell float64 reference: no ray may differ in kind, none by more than a
millimetre.
"""

import numpy as np
import pytest
from scenes.rasters import directions, rough_terrain, standing, with_holes

from ltm_core.base.types import Float64Array
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import PossibleGround
from ltm_lab.tracers.reference import trace_reference

RAYS_A_POSE = 250


def compare(
    dem: Dem,
    origin: Float64Array,
    rays: Float64Array,
    bend: float | None = None,
    possible: PossibleGround = PossibleGround(),
) -> np.ndarray:
    """Assert that both tracers agree on every ray; returns the fast tracer's ranges."""
    tracer = TerrainTracer(dem, possible=possible)
    if bend is not None:
        tracer.bend = bend
    fast = tracer.trace_rays(origin, rays).astype(np.float64)
    slow = trace_reference(dem, origin, rays, tracer.bend, possible)
    for kind in (np.isnan, np.isinf):
        wrong = np.flatnonzero(kind(fast) != kind(slow))
        assert wrong.size == 0, f"{rays[wrong[0]]} from {origin}: {fast[wrong[0]]} against {slow[wrong[0]]}"
    hit = np.isfinite(slow)
    error = np.abs(fast[hit] - slow[hit])
    allowed = 1e-4 + np.spacing(slow[hit].astype(np.float32))
    assert (error <= allowed).all(), f"range off by up to {error.max()} m"
    return fast


def poses(dem: Dem, rng: np.random.Generator, count: int) -> list[Float64Array]:
    """Positions above known ground, 0.3 to 40 m high."""
    found: list[Float64Array] = []
    while len(found) < count:
        row, col = (rng.uniform(0, n - 1) for n in dem.elevation.shape)
        position = standing(dem, row, col, float(rng.choice([0.3, 2.0, 10.0, 40.0])))
        if np.isfinite(position).all():
            found.append(position)
    return found


@pytest.mark.parametrize(("seed", "resolution"), [(1, 1.0), (2, 7.5)])
def test_whole_terrain(seed: int, resolution: float) -> None:
    dem = rough_terrain(seed, resolution=resolution, relief=60.0 * resolution, x_min=412_345.678, y_max=3_801_234.5)
    rng = np.random.default_rng(seed)
    low_beyond = PossibleGround(margin=10.0)  # so that some rays leave above all that may lie ahead
    kinds = [compare(dem, p, directions(rng, RAYS_A_POSE), possible=low_beyond) for p in poses(dem, rng, 16)]
    seen = np.concatenate(kinds)
    assert np.isfinite(seen).mean() > 0.5
    assert np.isinf(seen).any()
    assert np.isnan(seen).any()


@pytest.mark.parametrize(("bend", "low_deg"), [(7e-4, -20.0), (1e-2, -50.0)])
def test_strongly_bent_rays(bend: float, low_deg: float) -> None:
    """Bends far beyond the earth's, so that rays dip into cells and blocks and rise out of them again."""
    dem = with_holes(rough_terrain(6, relief=25.0), 6, specks=20, margin=False)
    rng = np.random.default_rng(6)
    for p in poses(dem, rng, 8):
        compare(dem, p, directions(rng, RAYS_A_POSE, low_deg, 5), bend=bend)


def test_rays_along_grid_lines_and_through_nodes() -> None:
    dem = with_holes(rough_terrain(7), 7, specks=30)
    known = np.argwhere(np.isfinite(dem.elevation))
    rng = np.random.default_rng(7)
    slopes = np.linspace(-0.8, 0.2, 41)
    for heading in [(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (2, 1), (-1, 3)]:
        for row, col in known[rng.integers(0, len(known), 4)]:
            position = standing(dem, float(row), float(col), 5.0)
            if not np.isfinite(position).all():
                continue
            rays = np.stack([np.full(41, heading[0]), np.full(41, heading[1]), slopes], axis=-1).astype(np.float64)
            compare(dem, position, rays)
