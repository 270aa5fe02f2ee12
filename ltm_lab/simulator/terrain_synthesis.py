"""Synthetic terrain: a seeded range of hills with ridges, ravines and a connected drainage net."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator import erosion, noise_fields
from ltm_lab.simulator.scenario import GroundConfig

_COARSEST = 64.0  # m; evolution starts here and halves the cell four times
_STEPS = {64.0: 160, 32.0: 40, 16.0: 24, 8.0: 12}
_TIME_STEP = 5.0e4  # years
_UPLIFT = 1.0e-4  # m/a; only its ratio to the erodibility matters, since relief is rescaled at the end
_AREA_EXPONENT = 0.42


@dataclass(frozen=True)
class HeightField:
    """Elevation (H, W) float32 metres at the cell centres of `geometry` (map frame); bilinear between them."""

    elevation: Float32Array
    geometry: GridGeometry

    def axes(self) -> tuple[Float64Array, Float64Array]:
        """Cell-centre coordinates: xs (W,) eastwards, ys (H,) southwards."""
        return axes(self.geometry)

    def at(self, x: ArrayLike, y: ArrayLike) -> Float64Array:
        """Elevation at map points; the border value outside."""
        row, col = self.geometry.to_grid(x, y)
        at = np.stack([np.ravel(row), np.ravel(col)])
        z = ndimage.map_coordinates(self.elevation, at, np.float64, order=1, mode="nearest")
        return np.asarray(z.reshape(np.shape(row)), np.float64)

    def gradient(self) -> tuple[Float32Array, Float32Array]:
        """(dz/dx, dz/dy), positive towards east and north."""
        down, right = np.gradient(self.elevation, self.geometry.resolution)
        return np.asarray(right, np.float32), np.asarray(-down, np.float32)


@dataclass(frozen=True)
class SyntheticTerrain:
    """The ground of a scene.

    `site`: what the DEM covers, in full detail. `surroundings`: the wider range at a coarser cell, same ground
    inside the site. `wetness`: log10 of upstream area (m^2) on the surroundings' grid. `far`: what lies beyond them;
    None: mountain ranges that are made up.
    """

    site: HeightField
    surroundings: HeightField
    wetness: Float32Array
    far: HeightField | None = None


def _grid(extent: tuple[float, float, float, float], cell: float) -> GridGeometry:
    x_min, y_min, x_max, y_max = extent
    return GridGeometry(x_min, y_max, cell, round((x_max - x_min) / cell), round((y_max - y_min) / cell))


def axes(geometry: GridGeometry) -> tuple[Float64Array, Float64Array]:
    """Return the cell-centre coordinates of a grid: xs (W,) eastwards, ys (H,) southwards."""
    xs, _ = geometry.to_map(0, np.arange(geometry.width))
    _, ys = geometry.to_map(np.arange(geometry.height), 0)
    return xs, ys


def _resample(field: Float64Array, old: GridGeometry, new: GridGeometry, order: int = 3) -> Float64Array:
    """`field` on `old` sampled at the cell centres of `new`."""
    rows, _ = old.to_grid(0.0, new.to_map(np.arange(new.height), 0)[1])
    _, cols = old.to_grid(new.to_map(0, np.arange(new.width))[0], 0.0)
    grid = np.meshgrid(rows, cols, indexing="ij")
    return np.asarray(ndimage.map_coordinates(field, grid, order=order, mode="nearest"), np.float64)


def make_terrain(config: GroundConfig, seed: int) -> SyntheticTerrain:
    """Evolve the range that `config` describes; the same seed gives the same ground, bit by bit on one machine."""
    size = config.size
    half = config.surroundings / 2
    extent = (size / 2 - half, size / 2 - half, size / 2 + half, size / 2 + half)
    height: Float64Array | None = None
    old = _grid(extent, _COARSEST)
    for cell, steps in _STEPS.items():
        geometry = _grid(extent, cell)
        xs, ys = axes(geometry)
        rough = noise_fields.fractal(xs, ys, 900.0, seed + 11, octaves=6, gain=0.6).astype(np.float64)
        height = 120.0 * (1.0 + rough) if height is None else _resample(height, old, geometry) + 0.06 * cell * rough
        lift = 1.0 + 0.35 * noise_fields.fractal(xs, ys, 3500.0, seed + 23, octaves=2)
        # A range that falls off towards its edges, elongated east-west as the Transverse Ranges are
        u, v = np.meshgrid((xs - size / 2) / half, (ys - size / 2) / half)
        lift *= np.clip(1.35 - np.maximum(np.abs(u) * 0.8, np.abs(v)) ** 2, 0.2, None)
        hardness = np.exp(0.5 * noise_fields.fractal(xs, ys, 1200.0, seed + 37, octaves=3))
        erosion.evolve(
            height,
            cell,
            np.ascontiguousarray(_UPLIFT * lift, np.float64),
            np.ascontiguousarray(config.erodibility / hardness, np.float64),
            steps,
            _TIME_STEP * (cell / _COARSEST) ** 0.7,
            _AREA_EXPONENT,
            config.diffusivity,
            config.repose,
            seed,
        )
        old = geometry
    assert height is not None  # nosec B101 # tells the type checker what holds
    height = _warped(height, old, seed)
    inside = _resample(height, old, _grid((0.0, 0.0, size, size), 16.0), order=1)
    scale = config.relief / (inside.max() - inside.min())
    height = (height - inside.min()) * scale + config.base_elevation
    site_geometry = _grid((0.0, 0.0, config.size, config.size), config.resolution)
    wetness = np.log10(erosion.drainage_area(height, old.resolution)).astype(np.float32)
    surroundings = HeightField(height.astype(np.float32), old)
    site = HeightField(_detailed(surroundings, site_geometry, config, seed), site_geometry)
    return SyntheticTerrain(site, surroundings, wetness)


def _warped(height: Float64Array, geometry: GridGeometry, seed: int) -> Float64Array:
    """`height` with its plan bent smoothly, and broad swells added: takes out what is left of the raster's
    directions."""
    xs, ys = axes(geometry)
    shift = [110.0 * noise_fields.fractal(xs, ys, 800.0, seed + k, octaves=3, gain=0.45) for k in (61, 67)]
    rows, cols = np.meshgrid(np.arange(geometry.height), np.arange(geometry.width), indexing="ij")
    at = [rows + shift[0] / geometry.resolution, cols + shift[1] / geometry.resolution]
    swell = 22.0 * noise_fields.fractal(xs, ys, 500.0, seed + 71, octaves=4, gain=0.45)
    return np.asarray(ndimage.map_coordinates(height, at, order=3, mode="nearest") + swell, np.float64)


def _detailed(coarse: HeightField, geometry: GridGeometry, config: GroundConfig, seed: int) -> Float32Array:
    """The evolved ground at the site's own cell, with relief below the evolution's scale: rills, benches, outcrops."""
    base = _resample(coarse.elevation.astype(np.float64), coarse.geometry, geometry)
    xs, ys = axes(geometry)
    down, right = np.gradient(base, geometry.resolution)
    steep = np.clip(np.hypot(down, right) / 0.6, 0.0, 1.5)
    rills = noise_fields.fractal(xs, ys, 70.0, seed + 51, octaves=4, gain=0.55, ridged=True)
    bumps = noise_fields.fractal(xs, ys, 45.0, seed + 53, octaves=4, gain=0.5)
    return np.asarray(base + config.roughness * (1.6 * steep * rills + 0.6 * bumps), np.float32)
