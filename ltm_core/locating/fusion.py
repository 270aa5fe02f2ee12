"""Fuse sightings on one raster of the map, from coarse to fine."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ltm_core.base.kernels import kernel
from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.locating.sighting import Bounds, LocatingTerrain, Sight


def sight_rasters(sight: Sight, window: GridGeometry) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Rasterise a fan: every sample covers its part of the sector, as long as its step and as wide as its share. Return
    (H, W) density of the marked direction, given the cell, 0 where the fan has no sample; fit of the cell's best
    sample; metres above the ground from which something is visible."""
    fan, likelihood, eye = sight.fan, sight.likelihood, sight.position
    sums = np.zeros((4, *window.shape))
    origin = np.array([eye[0] - window.x_min, window.y_max - eye[1]]) / window.resolution
    densities = likelihood.density, likelihood.fit, likelihood.lifts
    _splat(fan.ranges, fan.steps, fan.widths, fan.azimuths, *densities, origin, 1 / window.resolution, sums)
    total, area, lift, fit = sums
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(area > 0, total / area, 0.0), fit, np.where(total > 0, lift / total, 0.0)


@kernel(nogil=True)
def _splat(
    ranges: Float64Array,
    steps: Float64Array,
    widths: Float64Array,
    azimuths: Float64Array,
    density: Float64Array,
    fits: Float32Array,
    lifts: Float32Array,
    origin: Float64Array,
    per_metre: float,
    sums: Float64Array,
) -> None:
    """Add density x area, area, lift x both and the best fit to `sums` (4, H, W). `origin`: of the fan in cells."""
    total, area, lift, fit = sums[0], sums[1], sums[2], sums[3]
    height, width = total.shape
    for a in range(density.shape[0]):
        sine, cosine = math.sin(azimuths[a]), math.cos(azimuths[a])
        for k in range(density.shape[1]):
            r = ranges[k] - 0.5 * steps[k]
            x, y = origin[0] + sine * r * per_metre, origin[1] - cosine * r * per_metre
            if not (0 <= x < width and 0 <= y < height):
                continue
            i, j = int(y), int(x)
            part = r * steps[k] * widths[a]
            area[i, j] += part
            value = density[a, k] * part
            if value > 0:
                total[i, j] += value
                lift[i, j] += value * lifts[a, k]
                fit[i, j] = max(fit[i, j], fits[a, k])


_SIDE = 240  # number of cells along the longer side of a window
_FINEST = 0.5  # minimum cell size in metres
_BEYOND = 20.0  # excess of misfit over the best place above which a place is not refined
_ROUNDS = 3
_ALIKE = 8  # exponent of the cosine between two cameras by which they count as one: 0.76 at 15 degrees, 0.06 at 45
_SHRINKS = 0.5  # factor by which a window must shrink for another refinement


@dataclass(frozen=True, eq=False)
class Fused:
    """Fused raster, (H, W) each. `misfit`: T (see `locator`), +inf where a camera excludes a cell. `weight`: density of
    the posterior. `lift`: metres above ground from which the camera with the worst view of a cell sees something.
    `log_evidence`: logarithm of the probability density of all marks, over all places; -inf if none is possible."""

    window: GridGeometry
    misfit: Float64Array
    weight: Float64Array
    lift: Float64Array
    log_evidence: float

    @cached_property
    def least(self) -> float:
        return float(self.misfit.min())


def fused_closely(terrain: LocatingTerrain, sights: Sequence[Sight], turned: Sequence[Sight] = ()) -> Fused:
    """Fuse all sights at the resolution that their common places need. `turned`: of a camera turned by any angle."""
    shared = _shared([*sights, *turned])
    supports = [terrain.support(sight) for sight in sights]
    edges = np.array([bounds for bounds, _ in supports])
    low, high = edges[:, :2].max(axis=0), edges[:, 2:].min(axis=0)
    if (high <= low).any():  # no place for all: the raster says so of every cell
        low, high = edges[:, :2].min(axis=0), edges[:, 2:].max(axis=0)
    finest = max(max(cell for _, cell in supports), float((high - low).max()) / _SIDE)
    window = covering((float(low[0]), float(low[1]), float(high[0]), float(high[1])), finest)
    found = _fused(terrain, sights, shared, window)
    for number in range(_ROUNDS):
        if not np.isfinite(found.least):
            break
        rows, cols = np.nonzero(found.misfit < found.least + _BEYOND)
        x_min, y_max = (float(v) for v in found.window.to_map(rows.min() - 1.5, cols.min() - 1.5))
        x_max, y_min = (float(v) for v in found.window.to_map(rows.max() + 1.5, cols.max() + 1.5))
        extent = max(x_max - x_min, y_max - y_min)
        before = found.window.resolution * max(found.window.shape)
        if number > 0 and extent > _SHRINKS * before:
            break
        wanted = max(_FINEST, extent / _SIDE)
        bounds = x_min, y_min, x_max, y_max
        closer = [terrain.look_closer(sight, bounds, wanted) for sight in sights]
        others = [terrain.look_closer(sight, bounds, wanted, turned=True) for sight in turned]
        resolution = max(wanted, *(sight.cell for sight in (*closer, *others)))
        found = _fused(terrain, closer, shared, covering(bounds, resolution), others)
    return found


def _shared(sights: Sequence[Sight]) -> dict[str, float]:
    """Return, by camera, the number of cameras with this viewing direction, which share errors of terrain and plume."""
    azimuths = {sight.name: float(sight.directions.azimuth @ sight.directions.weights) for sight in sights}
    return {
        name: sum(math.cos(azimuth - other) ** _ALIKE for other in azimuths.values())
        for name, azimuth in azimuths.items()
    }


def mixture(parts: Sequence[Fused], shares: Sequence[float]) -> Fused:
    """Return the mixture of several posteriors, one of which is true, on one raster."""
    if len(parts) == 1:
        return parts[0]
    bounds = np.array([part.window.bounds for part in parts])
    low, high = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
    resolution = max(max(part.window.resolution for part in parts), float((high - low).max()) / _SIDE)
    window = covering((float(low[0]), float(low[1]), float(high[0]), float(high[1])), resolution)
    weight, lift = np.zeros(window.shape), np.zeros(window.shape)
    for part, share in zip(parts, shares, strict=True):
        if not part.weight.any():
            continue
        rows, cols = np.nonzero(part.weight)
        i, j = window.cell_of(*part.window.to_map(rows, cols))
        values = part.weight[rows, cols] * share / part.weight.sum()
        np.add.at(weight, (i, j), values)
        np.add.at(lift, (i, j), values * part.lift[rows, cols])
    with np.errstate(invalid="ignore", divide="ignore"):
        lift = np.where(weight > 0, lift / weight, 0.0)
    least = min(part.least for part in parts)
    return Fused(window, np.where(weight > 0, least, np.inf), weight, lift, -math.inf)


def covering(bounds: Bounds, resolution: float) -> GridGeometry:
    """Return a grid at whole multiples of the resolution from the origin: equal places give equal rasters."""
    return GridGeometry.snapped(bounds, resolution, 0.0)


def _fused(
    terrain: LocatingTerrain,
    sights: Sequence[Sight],
    shared: Mapping[str, float],
    window: GridGeometry,
    turned: Sequence[Sight] = (),
) -> Fused:
    by_camera: dict[str, list[tuple[Float64Array, Float64Array, Float64Array]]] = {}
    positions: dict[str, Float64Array] = {}
    possible = np.ones(window.shape, np.bool_)
    for sight in (*sights, *turned):
        rasters = sight_rasters(sight, window)
        by_camera.setdefault(sight.name, []).append(rasters)
        positions[sight.name] = sight.position
        possible &= rasters[0] > 0
    rows, cols = np.nonzero(possible)
    misfit, weight, lift = np.full(window.shape, np.inf), np.zeros(window.shape), np.zeros(window.shape)
    if not len(rows):
        return Fused(window, misfit, weight, lift, -math.inf)
    x, y = window.to_map(rows, cols)
    fit, density, evidence, raised = (np.zeros(len(rows)) for _ in range(4))
    loose = {sight.name for sight in turned}
    for name, marks in by_camera.items():
        part = 1 / (shared[name] * len(marks))
        for of_mark, best, lifted in marks:
            fit += np.log(np.maximum(best[rows, cols], 1e-30)) / len(marks)
            here = np.log(of_mark[rows, cols])
            density += here * part
            evidence += here / len(marks)
            if name not in loose:  # what it marks may be something else
                raised = np.maximum(raised, lifted[rows, cols])
        squared = (x - positions[name][0]) ** 2 + (y - positions[name][1]) ** 2
        noticed = np.log1p(squared / terrain.config.detection_range**2)
        density -= noticed / shared[name]
        evidence -= noticed
    rising = np.log(terrain.chance(raised))
    density += rising
    evidence += rising
    misfit[rows, cols] = -2 * (fit + rising)
    weight[rows, cols] = np.exp(density - density.max())
    lift[rows, cols] = raised
    greatest = float(evidence.max())
    total = greatest + math.log(float(np.exp(evidence - greatest).sum()) * window.resolution**2)
    return Fused(window, misfit, weight, lift, total)
