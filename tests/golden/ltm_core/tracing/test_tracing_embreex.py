"""Against Embree, which nobody here wrote, on a mesh of two triangles a cell.

Triangles and the bilinear surface differ inside a cell, and by whole ridges at silhouettes: so percentiles are
compared.
"""

import numpy as np
import pytest
from scenes.rasters import directions, rough_terrain, standing

from ltm_core.base.types import Float64Array
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer


def embree_ranges(dem: Dem, origin: Float64Array, rays: Float64Array) -> Float64Array:
    """Range of the first triangle on each ray; +inf where there is none."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    rows, cols = dem.elevation.shape
    row, col = np.mgrid[0:rows, 0:cols]
    x, y = dem.geometry.to_map(row, col)
    vertices = np.stack([x, y, dem.elevation], axis=-1).reshape(-1, 3).astype(np.float32)
    index = np.arange(rows * cols).reshape(rows, cols)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    faces = np.concatenate([np.stack([a, c, b], -1), np.stack([b, c, d], -1)]).astype(np.int32)
    scene = EmbreeScene()
    TriangleMesh(scene, vertices, faces)
    origins = np.broadcast_to(origin, rays.shape).astype(np.float32)
    distance = scene.run(origins, rays.astype(np.float32), query="DISTANCE").astype(np.float64)
    return np.where(distance > 1e30, np.inf, distance)


@pytest.mark.parametrize("seed", [31, 32])
def test_percentiles_against_embree(seed: int) -> None:
    dem = rough_terrain(seed, shape=(211, 330), resolution=2.0, relief=140.0)
    rng = np.random.default_rng(seed)
    tracer = TerrainTracer(dem, curvature=False)
    differences, same_kind = [], []
    for _ in range(8):
        origin = standing(dem, rng.uniform(20, 190), rng.uniform(20, 310), rng.uniform(2, 30))
        rays = directions(rng, 4000)
        ours = tracer.trace_rays(origin, rays)
        theirs = embree_ranges(dem, origin, rays)
        same_kind.append(np.isfinite(ours) == np.isfinite(theirs))
        both = np.isfinite(ours) & np.isfinite(theirs)
        differences.append(np.abs(ours[both] - theirs[both]))
    error = np.concatenate(differences)
    assert len(error) > 10_000
    assert np.concatenate(same_kind).mean() > 0.995
    p50, p90, p99 = np.percentile(error, [50, 90, 99])
    print(f"{len(error)} rays: p50 {p50:.4f} m, p90 {p90:.4f} m, p99 {p99:.4f} m")
    assert p50 < 0.05
    assert p90 < 0.6
    assert p99 < 5.0
