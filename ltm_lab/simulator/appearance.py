"""Linear reflectances of plants and ground of a southern-Californian hillside, by season."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator import noise_fields
from ltm_lab.simulator.landcover import BARE, BUILT, GRASS, SHRUB, TREE, WATER, LandCover
from ltm_lab.simulator.terrain_synthesis import axes

_STRIP = 128  # rows of ground texture made at once
_THREADS = 2
_WATER = np.array([0.02, 0.035, 0.036])  # a reservoir's own colour, under its reflections


def _rgb(*values: float) -> Float64Array:
    return np.array(values, np.float64)


@dataclass(frozen=True)
class Reflectances:
    """Linear RGB reflectances."""

    grass: Float64Array
    chamise: Float64Array  # dark chaparral
    sage: Float64Array  # grey-green coastal scrub
    buckwheat: Float64Array  # rust-brown flower heads
    oak: Float64Array
    conifer: Float64Array
    soil: Float64Array
    rock: Float64Array
    litter: Float64Array
    track: Float64Array
    char: Float64Array
    ash: Float64Array
    scorched: Float64Array  # foliage killed by heat


def palette(green: float, seed: int) -> Reflectances:
    """The colours of one season (`green` 0 cured .. 1 a wet spring), varied a little from site to site."""
    rng = np.random.default_rng([seed, 77])

    def vary(color: Float64Array) -> Float64Array:
        return np.asarray(color * rng.uniform(0.88, 1.14) * (1 + 0.04 * rng.normal(size=3)), np.float64)

    def season(cured: Float64Array, wet: Float64Array) -> Float64Array:
        return vary((1 - green) * cured + green * wet)

    return Reflectances(
        grass=season(_rgb(0.40, 0.305, 0.155), _rgb(0.135, 0.19, 0.055)),
        chamise=season(_rgb(0.098, 0.099, 0.045), _rgb(0.074, 0.104, 0.036)),
        sage=season(_rgb(0.165, 0.158, 0.098), _rgb(0.125, 0.155, 0.085)),
        buckwheat=season(_rgb(0.175, 0.105, 0.058), _rgb(0.15, 0.15, 0.08)),
        oak=vary(_rgb(0.058, 0.076, 0.030)),
        conifer=vary(_rgb(0.040, 0.060, 0.030)),
        soil=vary(_rgb(0.33, 0.264, 0.168)),
        rock=vary(_rgb(0.345, 0.31, 0.24)),
        litter=vary(_rgb(0.16, 0.125, 0.08)),
        track=vary(_rgb(0.47, 0.385, 0.275)),
        char=vary(_rgb(0.022, 0.02, 0.018)),
        ash=vary(_rgb(0.27, 0.262, 0.25)),
        scorched=vary(_rgb(0.19, 0.098, 0.043)),
    )


def ground_texture(cover: LandCover, geometry: GridGeometry, colors: Reflectances, seed: int) -> Float32Array:
    """Reflectance (H, W, 3) of the ground itself at the cells of `geometry`, plants left out.

    Strip by strip: a whole site at once takes gigabytes.
    """
    out = np.empty((*geometry.shape, 3), np.float32)

    def fill(first: int) -> None:
        rows = min(_STRIP, geometry.height - first)
        y_max = geometry.y_max - first * geometry.resolution
        strip = GridGeometry(geometry.x_min, y_max, geometry.resolution, geometry.width, rows)
        out[first : first + rows] = _strip_texture(cover, strip, colors, seed)

    with ThreadPoolExecutor(_THREADS) as pool:
        list(pool.map(fill, range(0, geometry.height, _STRIP)))
    return out


def _strip_texture(cover: LandCover, geometry: GridGeometry, colors: Reflectances, seed: int) -> Float32Array:
    """A part of `ground_texture`.

    Classes melt into one another over a few metres along ragged edges; brightness varies from hundreds of metres
    down to the cell.
    """
    xs, ys = axes(geometry)
    cell = geometry.resolution
    ragged = [7.0 * noise_fields.fractal(xs, ys, 24.0, seed + 301 + k, octaves=3, gain=0.6) for k in range(2)]
    x, y = xs[None, :] + ragged[0], ys[:, None] + ragged[1]
    classes = cover.at(x, y)
    broad = noise_fields.fractal(xs, ys, 420.0, seed + 311, octaves=5, gain=0.6)[..., None]
    fine = noise_fields.fractal(xs, ys, max(26.0, 4 * cell), seed + 313, octaves=5, gain=0.75)[..., None]
    patchy = noise_fields.fractal(xs, ys, max(60.0, 6 * cell), seed + 317, octaves=4, gain=0.6)[..., None]
    moist = np.clip(cover.sample(cover.moisture, x, y)[..., None], -1, 1)
    stones = np.clip(0.5 + 1.8 * patchy, 0, 1)
    grass = colors.grass * (1 + 0.25 * broad) + np.clip(moist + 0.6 * patchy - 0.1, 0, 1) * 0.35 * (
        _rgb(0.14, 0.165, 0.06) - colors.grass
    )
    thin = np.clip(1.6 * patchy - 0.15, 0, 0.65)
    grass = (1 - thin) * grass + thin * (0.6 * colors.soil + 0.4 * colors.litter)
    under_shrub = (1 - 0.55 * stones) * colors.litter + 0.55 * stones * colors.soil
    under_tree = 0.6 * colors.litter + 0.4 * grass
    rills = noise_fields.fractal(xs, ys, max(16.0, 4 * cell), seed + 319, octaves=3, gain=0.7, ridged=True)[..., None]
    bare = ((1 - stones) * colors.soil + stones * colors.rock) * (1 + 0.3 * rills + 0.2 * patchy)
    out = np.empty((*geometry.shape, 3), np.float32)
    out[:] = bare
    for class_id, color in ((GRASS, grass), (SHRUB, under_shrub), (TREE, under_tree)):
        out = np.where((classes == class_id)[..., None], color, out).astype(np.float32)
    # Ground that is bare without being rocky: what fire, felling and digging have left
    raw = (classes == BARE) & (cover.sample(cover.stand.rock, x, y) < 0.5)
    out = np.where(raw[..., None], (0.55 * colors.soil + 0.45 * colors.litter) * (1 + 0.2 * patchy), out)
    char = cover.sample(cover.stand.char, x, y)[..., None]
    ashes = np.clip(2.2 * fine + 0.9 * patchy - 0.35, 0, 1)
    burnt = (1 - ashes) * 1.5 * colors.char + ashes * (0.5 * colors.ash + 0.5 * colors.soil)
    out = np.where(char > 0.02, (1 - np.clip(1.25 * char, 0, 1)) * out + np.clip(1.25 * char, 0, 1) * burnt, out)
    out = np.where((classes == BUILT)[..., None], 0.8 * colors.soil, out)
    exact = np.meshgrid(xs, ys)
    out = np.where(((cover.sample(cover.road, *exact) > 0.5) & (classes == BARE))[..., None], colors.track, out)
    out *= 1 + 0.16 * broad + 0.34 * fine
    out = np.where((cover.at(*exact) == WATER)[..., None], _WATER, out)
    return np.clip(out, 0.015, 0.75).astype(np.float32)
