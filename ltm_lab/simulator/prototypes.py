"""Shared meshes of plants that a scene instances: single trees, and ground patches with all that grows on them.

A patch carries dozens of shrubs and is sheared onto the slope, so that a whole range of chaparral costs tens of
thousands of instances, not millions.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_lab.simulator import meshes
from ltm_lab.simulator.appearance import Reflectances
from ltm_lab.simulator.landcover import BARE, BUILT, GRASS, SHRUB, TREE
from ltm_lab.simulator.meshes import Soup

Rng = np.random.Generator

NEAR_PATCH, FAR_PATCH, TUFT_PATCH = 12.0, 24.0, 6.0  # m
STAGES = (0.3, 0.5, 0.75, 1.0, 1.15)  # heights, relative to mature shrubs, at which patches are made


@dataclass(frozen=True)
class Prototype:
    """One mesh that many instances share; `class_id` is what its pixels are."""

    name: str
    class_id: int
    soup: Soup


def _scatter(rng: Rng, side: float, spacing: float, keep: float) -> Float64Array:
    """Jittered-grid points (N >= 1, 2) over a square of `side` about the origin, thinned to the share `keep`."""
    n = max(1, round(side / spacing))
    at = (
        np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2) + rng.uniform(0.05, 0.95, (n * n, 2))
    ) / n
    draws = rng.uniform(size=n * n)
    return np.asarray((at[draws <= max(keep, draws.min())] - 0.5) * side, np.float64)


def _shrub_kind(rng: Rng, colors: Reflectances, scrub: bool) -> tuple[Float64Array, float, float]:
    """(colour, radius, height) of one shrub of tall chaparral or of low coastal scrub."""
    draw = rng.uniform()
    if scrub:
        if draw < 0.62:
            return colors.sage, rng.uniform(0.45, 0.95), rng.uniform(0.6, 1.3)
        if draw < 0.82:
            return colors.buckwheat, rng.uniform(0.35, 0.7), rng.uniform(0.4, 0.8)
        return colors.chamise, rng.uniform(0.7, 1.3), rng.uniform(1.0, 2.0)
    if draw < 0.7:
        return colors.chamise, rng.uniform(0.75, 1.5), rng.uniform(1.3, 2.6)
    if draw < 0.88:
        return 0.5 * (colors.chamise + colors.oak), rng.uniform(0.9, 1.8), rng.uniform(1.8, 3.4)
    return colors.sage, rng.uniform(0.5, 1.0), rng.uniform(0.7, 1.4)


def _shrub_patch(
    rng: Rng, colors: Reflectances, stage: float, scrub: bool, side: float, cover: float, leaves: int
) -> Soup:
    """`leaves` > 0: shrubs of leaf clumps; 0: plain domes, for the distance."""
    spacing = 1.25 if scrub else 1.6
    if leaves == 0:
        spacing *= 1.35
    parts = []
    for x, y in _scatter(rng, side, spacing, cover):
        color, radius, height = _shrub_kind(rng, colors, scrub)
        color = color * rng.uniform(0.75, 1.3)
        radius, height = radius * (0.25 + 0.75 * stage), height * stage
        if leaves:
            plant = meshes.shrub(rng, radius, height, color, leaves)
        else:
            radius *= 1.3
            plant = meshes.lump(rng, (radius, radius, 0.55 * height), 0.42 * height, 1.02 * color, rings=3, sides=6)
        parts.append(plant.moved(x, y, 1.0, rng.uniform(0, 2 * np.pi)))
    return Soup.joined(parts)


def _far_tree(rng: Rng, colors: Reflectances, conifer: bool) -> Soup:
    if conifer:
        h, r = rng.uniform(9, 17), rng.uniform(1.9, 3.2)
        body = meshes.lump(rng, (r, r, 0.5 * h), 0.52 * h, 0.95 * colors.conifer, rings=5, sides=6)
        taper = np.clip(1.35 - 1.2 * body.triangles[..., 2:] / h, 0.1, 1.0)
        tapered = body.triangles * np.concatenate([taper, taper, np.ones_like(taper)], axis=-1)
        return Soup(tapered, body.colors, body.normals)
    h, r = rng.uniform(5.5, 9.5), rng.uniform(3.0, 5.0)
    parts = []
    for _ in range(3):
        x, y = rng.normal(0, 0.33 * r, 2)
        k = rng.uniform(0.6, 0.8)
        crown = meshes.lump(rng, (k * r, k * r, 0.36 * h), 0.58 * h, colors.oak * rng.uniform(0.8, 1.25), 4, 7)
        parts.append(crown.moved(x, y, 1, 0))
    return Soup.joined(parts)


def _tree_patch(rng: Rng, colors: Reflectances, stage: float, conifer: bool, cover: float, singed: float) -> Soup:
    points = _scatter(rng, FAR_PATCH, 7.0, cover)
    trees = [_far_tree(rng, colors, conifer).moved(x, y, stage, rng.uniform(0, 6.28)) for x, y in points]
    return meshes.scorched(Soup.joined(trees), singed, colors.scorched)


def _strewn(points: Float64Array, make: Callable[[], Soup]) -> Soup:
    """Return one plant at each point (N, 2)."""
    return Soup.joined([make().moved(x, y, 1, 0) for x, y in points])


def _snag_patch(rng: Rng, colors: Reflectances, stage: float) -> Soup:
    at = _scatter(rng, FAR_PATCH, 7.5, 0.75)
    return _strewn(at, lambda: meshes.snag(rng, rng.uniform(6.0, 11.0), colors.char, boughs=5))


def _stick_patch(rng: Rng, colors: Reflectances, stage: float, side: float, spacing: float) -> Soup:
    """The charred stems that fire leaves of shrubs."""
    at = _scatter(rng, side, spacing, 0.8)
    return _strewn(at, lambda: meshes.stems(rng, rng.uniform(0.3, 0.8), rng.uniform(0.5, 1.5), colors.char, 5))


def _tuft_patch(rng: Rng, colors: Reflectances, spacing: float, blades: int, width: float) -> Soup:
    def tuft() -> Soup:
        radius, height = rng.uniform(0.1, 0.26), rng.uniform(0.15, 0.45)
        return meshes.tuft(rng, radius, height, colors.grass * rng.uniform(0.85, 1.25), blades, width)

    return _strewn(_scatter(rng, TUFT_PATCH, spacing, 0.8), tuft)


def _stone_patch(rng: Rng, colors: Reflectances, side: float, pebbles: int, boulders: int) -> Soup:
    """Stones and boulders, a third of each sunk into the ground."""
    parts = []
    for k in range(pebbles + boulders):
        size = rng.uniform(0.12, 0.4) if k < pebbles else 0.35 * rng.uniform(0.3, 1.0) ** -1.3
        radii = size, size * rng.uniform(0.6, 1.0), 0.6 * size
        stone = meshes.lump(rng, radii, 0.2 * size, colors.rock * rng.uniform(0.6, 1.15), rings=3, sides=5)
        x, y = rng.uniform(-side / 2, side / 2, 2)
        parts.append(stone.moved(x, y, 1.0, rng.uniform(0, 2 * np.pi)))
    return Soup.joined(parts)


def _shrub_one(rng: Rng, colors: Reflectances, stage: float, scrub: bool, leaves: int) -> Soup:
    """One shrub, as it stands in a patch."""
    return _shrub_patch(rng, colors, stage, scrub, 0.4, 1.0, leaves)


class Prototypes:
    """Every kind of plant and patch by name, each with its variants; made when first asked for, out of the seed and
    the name alone.

    A name may end in `@` and one of STAGES in percent: the same plants at that share of their mature size.
    """

    def __init__(self, colors: Reflectances, seed: int) -> None:
        self._colors = colors
        self._seed = seed
        self._made: dict[str, list[Prototype]] = {}
        self._kinds = _kinds()

    def __getitem__(self, name: str) -> list[Prototype]:
        if name not in self._made:
            kind, _, stage = name.partition("@")
            number = list(self._kinds).index(kind)
            rng = np.random.default_rng([self._seed, 31, number])
            class_id, variants, make = self._kinds[kind]
            colors = self._colors
            self._made[name] = [
                Prototype(f"{name}_{i}", class_id, make(rng, colors, float(stage or 100) / 100))
                for i in range(variants)
            ]
        return self._made[name]


_kept: dict[tuple[int, bytes], Prototypes] = {}
"""The set that was asked for last, some 300 MB: dates of one season share theirs."""


def prototypes(colors: Reflectances, seed: int) -> Prototypes:
    """Return the prototypes of these colours and this seed; making them takes longer than planting them."""
    key = seed, b"".join(np.ascontiguousarray(color).tobytes() for color in vars(colors).values())
    if key not in _kept:
        _kept.clear()
        _kept[key] = Prototypes(colors, seed)
    return _kept[key]


Maker = Callable[[Rng, Reflectances, float], Soup]


def _tree(rng: Rng, colors: Reflectances, stage: float, conifer: bool, singed: float) -> Soup:
    """A near tree; crowns below the share `singed` of its height are killed by heat."""
    if conifer:
        color = colors.conifer * rng.uniform(0.85, 1.2)
        soup = meshes.conifer(rng, 2.7, 13.0, color, 2600)
    else:
        color = colors.oak * rng.uniform(0.85, 1.2)
        soup = meshes.oak(rng, 4.2, 7.5, color, 3400)
    return meshes.scorched(soup, singed, colors.scorched)


def _kinds() -> dict[str, tuple[int, int, Maker]]:
    """Name: (class id, variants, maker)."""
    kinds: dict[str, tuple[int, int, Maker]] = {
        "stones": (BARE, 4, lambda r, c, s: _stone_patch(r, c, NEAR_PATCH, 110, 9)),
        "far_stones": (BARE, 3, lambda r, c, s: _stone_patch(r, c, FAR_PATCH, 0, 26)),
        "house": (BUILT, 6, lambda r, c, s: meshes.house(r)),
        "sticks": (BARE, 4, partial(_stick_patch, side=NEAR_PATCH, spacing=1.7)),
        "far_sticks": (BARE, 3, partial(_stick_patch, side=FAR_PATCH, spacing=3.0)),
        "tuft": (GRASS, 3, lambda r, c, s: _tuft_patch(r, c, 0.36, 9, 0.03)),
        "close_tuft": (GRASS, 3, lambda r, c, s: _tuft_patch(r, c, 0.2, 14, 0.007)),
        "lone_oak": (TREE, 2, lambda r, c, s: _far_tree(r, c, False)),
        "snag": (TREE, 5, lambda r, c, s: meshes.snag(r, r.uniform(6.0, 11.0), c.char)),
        "far_snag": (TREE, 3, _snag_patch),
    }
    for conifer in (False, True):
        name = "conifer" if conifer else "oak"
        for suffix, singed in (("", 0.0), ("_singed", 0.5), ("_scorched", 1.0)):
            kinds[name + suffix] = (TREE, 6, partial(_tree, conifer=conifer, singed=singed))
        for cover_suffix, cover in (("", 0.9), ("_sparse", 0.4)):
            for suffix, singed in (("", 0.0), ("_scorched", 1.0)):
                kinds[f"far_{name}{cover_suffix}{suffix}"] = (
                    TREE,
                    3,
                    partial(_tree_patch, conifer=conifer, cover=cover, singed=singed),
                )
    for scrub in (False, True):
        name = "scrub" if scrub else "chaparral"
        for suffix, cover in (("", 0.94), ("_half", 0.5), ("_sparse", 0.09)):
            near = partial(_shrub_patch, scrub=scrub, side=NEAR_PATCH, cover=cover, leaves=80)
            far = partial(_shrub_patch, scrub=scrub, side=FAR_PATCH, cover=cover, leaves=0)
            kinds[name + suffix] = (SHRUB, 5, near)
            kinds[f"far_{name}{suffix}"] = (SHRUB, 3, far)
            close = partial(_shrub_patch, scrub=scrub, side=NEAR_PATCH, cover=cover, leaves=1400)
            kinds[f"close_{name}{suffix}"] = (SHRUB, 3, close)
    # Kinds draw by their number in this list: new ones come last
    for name, scrub in (("chaparral", False), ("scrub", True)):
        for prefix, leaves in (("", 80), ("far_", 0), ("close_", 1400)):
            kinds[f"{prefix}{name}_one"] = (SHRUB, 7, partial(_shrub_one, scrub=scrub, leaves=leaves))
    return kinds
