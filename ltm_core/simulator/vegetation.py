"""Plants of a scene: prototypes (single trees, and patches of ground with everything that grows on them) and where
each of them stands.

A patch carries dozens of shrubs and is sheared onto the slope, so that a whole range of chaparral costs tens of
thousands of instances, not millions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ltm_core.simulator import meshes, noise
from ltm_core.simulator.appearance import Palette
from ltm_core.simulator.landcover import BARE, GRASS, SHRUB, TREE, LandCover
from ltm_core.simulator.meshes import Soup
from ltm_core.simulator.scenario import VegetationConfig
from ltm_core.simulator.terrain import Terrain

Array = NDArray[np.float64]
Rng = np.random.Generator

NEAR_PATCH, FAR_PATCH, TUFT_PATCH = 12.0, 24.0, 6.0  # m
_TREE_SPACING = 8.5  # m, jittered grid


@dataclass(frozen=True)
class Prototype:
    """One mesh that many instances share; `class_id` is what its pixels are."""

    name: str
    class_id: int
    soup: Soup


@dataclass(frozen=True)
class Placement:
    """Instances of one prototype: `transforms` (N, 4, 4), prototype to map."""

    prototype: Prototype
    transforms: Array


def _scatter(rng: Rng, side: float, spacing: float, keep: float) -> Array:
    """Jittered-grid points (N, 2) over a square of `side` about the origin, thinned to the share `keep`."""
    n = max(1, round(side / spacing))
    at = (
        np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2) + rng.uniform(0.05, 0.95, (n * n, 2))
    ) / n
    return np.asarray((at[rng.uniform(size=n * n) < keep] - 0.5) * side, np.float64)


def _shrub_kind(rng: Rng, colors: Palette, scrub: bool) -> tuple[Array, float, float]:
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


def _shrub_patch(rng: Rng, colors: Palette, scrub: bool, side: float, cover: float, leaves: int) -> Soup:
    """`leaves` > 0: shrubs of leaf clumps; 0: plain domes, for the distance."""
    spacing = 1.25 if scrub else 1.6
    if leaves == 0:
        spacing *= 1.35
    parts = []
    for x, y in _scatter(rng, side, spacing, cover):
        color, radius, height = _shrub_kind(rng, colors, scrub)
        color = color * rng.uniform(0.75, 1.3)
        if leaves:
            plant = meshes.shrub(rng, radius, height, color, leaves)
        else:
            radius *= 1.3
            plant = meshes.lump(rng, (radius, radius, 0.55 * height), 0.42 * height, 1.02 * color, rings=3, sides=6)
        parts.append(plant.moved(x, y, 1.0, rng.uniform(0, 2 * np.pi)))
    return Soup.joined(parts)


def _far_tree(rng: Rng, colors: Palette, conifer: bool) -> Soup:
    if conifer:
        h, r = rng.uniform(9, 17), rng.uniform(1.9, 3.2)
        body = meshes.lump(rng, (r, r, 0.5 * h), 0.52 * h, 0.95 * colors.conifer, rings=5, sides=6)
        taper = np.clip(1.35 - 1.2 * body.triangles[..., 2:] / h, 0.1, 1.0)
        return Soup(body.triangles * np.concatenate([taper, taper, np.ones_like(taper)], axis=-1), body.colors)
    h, r = rng.uniform(5.5, 9.5), rng.uniform(3.0, 5.0)
    parts = []
    for _ in range(3):
        x, y = rng.normal(0, 0.33 * r, 2)
        k = rng.uniform(0.6, 0.8)
        parts.append(
            meshes.lump(rng, (k * r, k * r, 0.36 * h), 0.58 * h, colors.oak * rng.uniform(0.8, 1.25), 4, 7).moved(
                x, y, 1, 0
            )
        )
    return Soup.joined(parts)


def _tree_patch(rng: Rng, colors: Palette, conifer: bool, cover: float) -> Soup:
    points = _scatter(rng, FAR_PATCH, 7.0, cover)
    if len(points) == 0:
        points = np.zeros((1, 2))
    return Soup.joined([_far_tree(rng, colors, conifer).moved(x, y, 1, rng.uniform(0, 6.28)) for x, y in points])


def _tuft_patch(rng: Rng, colors: Palette) -> Soup:
    return Soup.joined(
        [
            meshes.tuft(
                rng, rng.uniform(0.12, 0.3), rng.uniform(0.15, 0.42), colors.grass * rng.uniform(0.8, 1.2), 9
            ).moved(x, y, 1, 0)
            for x, y in _scatter(rng, TUFT_PATCH, 0.36, 0.8)
        ]
    )


def _stone_patch(rng: Rng, colors: Palette, side: float, pebbles: int, boulders: int) -> Soup:
    """Stones and boulders, a third of each sunk into the ground."""
    parts = []
    for k in range(pebbles + boulders):
        size = rng.uniform(0.12, 0.4) if k < pebbles else 0.35 * rng.uniform(0.3, 1.0) ** -1.3
        stone = meshes.lump(
            rng,
            (size, size * rng.uniform(0.6, 1.0), 0.6 * size),
            0.2 * size,
            colors.rock * rng.uniform(0.6, 1.15),
            3,
            5,
        )
        x, y = rng.uniform(-side / 2, side / 2, 2)
        parts.append(stone.moved(x, y, 1.0, rng.uniform(0, 2 * np.pi)))
    return Soup.joined(parts)


class Prototypes:
    """Every kind of plant and patch by name, each with its variants; made when first asked for, out of the seed and
    the name alone."""

    def __init__(self, colors: Palette, seed: int) -> None:
        self._colors = colors
        self._seed = seed
        self._made: dict[str, list[Prototype]] = {}
        self._kinds = _kinds()

    def __getitem__(self, name: str) -> list[Prototype]:
        if name not in self._made:
            number = list(self._kinds).index(name)
            rng = np.random.default_rng([self._seed, 31, number])
            class_id, variants, make = self._kinds[name]
            self._made[name] = [Prototype(f"{name}_{i}", class_id, make(rng, self._colors)) for i in range(variants)]
        return self._made[name]


def _kinds() -> dict[str, tuple[int, int, Callable[[Rng, Palette], Soup]]]:
    """Name: (class id, variants, maker)."""
    kinds: dict[str, tuple[int, int, Callable[[Rng, Palette], Soup]]] = {
        "stones": (BARE, 4, lambda r, c: _stone_patch(r, c, NEAR_PATCH, 110, 9)),
        "far_stones": (BARE, 3, lambda r, c: _stone_patch(r, c, FAR_PATCH, 0, 26)),
        "tuft": (GRASS, 3, _tuft_patch),
        "oak": (TREE, 6, lambda r, c: meshes.oak(r, 4.2, 7.5, c.oak * r.uniform(0.85, 1.2), 3400)),
        "conifer": (TREE, 6, lambda r, c: meshes.conifer(r, 2.7, 13.0, c.conifer * r.uniform(0.85, 1.2), 2600)),
        "lone_oak": (TREE, 2, lambda r, c: _far_tree(r, c, False)),
    }
    for conifer in (False, True):
        for suffix, cover in (("", 0.9), ("_sparse", 0.4)):
            name = f"far_{'conifer' if conifer else 'oak'}{suffix}"
            kinds[name] = (TREE, 3, partial(_tree_patch, conifer=conifer, cover=cover))
    for scrub in (False, True):
        name = "scrub" if scrub else "chaparral"
        for suffix, cover in (("", 0.94), ("_half", 0.5), ("_sparse", 0.09)):
            near = partial(_shrub_patch, scrub=scrub, side=NEAR_PATCH, cover=cover, leaves=80)
            far = partial(_shrub_patch, scrub=scrub, side=FAR_PATCH, cover=cover, leaves=0)
            kinds[name + suffix] = (SHRUB, 5, near)
            kinds[f"far_{name}{suffix}"] = (SHRUB, 3, far)
    return kinds


class Planting:
    """Where plants stand. Placement is a function of the ground and the seed; the eye only chooses the level of
    detail."""

    def __init__(
        self, terrain: Terrain, cover: LandCover, config: VegetationConfig, colors: Palette, seed: int
    ) -> None:
        self._terrain = terrain
        self._cover = cover
        self._config = config
        self._seed = seed
        self._prototypes = Prototypes(colors, seed)

    def ground(self, x: Array, y: Array) -> Array:
        """Height of the ground that is rendered at map points: the site's inside it, the surroundings' outside."""
        g = self._terrain.site.geometry
        half = g.resolution / 2
        inside = (x >= g.x_min + half) & (x <= g.x_max - half) & (y >= g.y_min + half) & (y <= g.y_max - half)
        return np.where(inside, self._terrain.site.at(x, y), self._terrain.surroundings.at(x, y))

    def around(self, eye: Array) -> list[Placement]:
        """All instances for a camera at map point `eye` (3,)."""
        out: list[Placement] = []
        x, y = self._cells(FAR_PATCH)
        near = np.hypot(x - eye[0], y - eye[1]) < self._config.detail_radius
        out += self._patches(x[~near], y[~near], FAR_PATCH, "far_")
        quarter = np.array([-0.25, 0.25]) * FAR_PATCH
        x_near = (x[near][:, None] + np.array([quarter[0], quarter[1], quarter[0], quarter[1]])).ravel()
        y_near = (y[near][:, None] + np.array([quarter[0], quarter[0], quarter[1], quarter[1]])).ravel()
        out += self._patches(x_near, y_near, NEAR_PATCH, "")
        out += self._trees(eye)
        if self._config.grass_radius > 0:
            out += self._tufts(eye)
        return out

    def _cells(self, side: float) -> tuple[Array, Array]:
        """Centres of the square cells of `side` over the surroundings, less a margin."""
        g = self._terrain.surroundings.geometry
        xs = np.arange(g.x_min + 2 * side, g.x_max - 2 * side, side)
        ys = np.arange(g.y_min + 2 * side, g.y_max - 2 * side, side)
        x, y = np.meshgrid(xs, ys)
        return x.ravel(), y.ravel()

    def _shares(self, x: Array, y: Array, side: float) -> Array:
        """Share of each class (N, 5) in square cells, from 3 x 3 samples."""
        offsets = (np.arange(3) - 1) * side / 3
        shares = np.zeros((len(x), 5))
        for dx in offsets:
            for dy in offsets:
                classes = self._cover.at(x + dx, y + dy)
                shares[np.arange(len(x)), np.minimum(classes, 4)] += 1 / 9
        return shares

    def _noise(self, x: Array, y: Array, wavelength: float, salt: int) -> Array:
        """Noise in [-1, 1] at scattered points."""
        return noise.at_points(x, y, wavelength, self._seed + salt)

    def _draw(self, x: Array, y: Array, salt: int) -> Array:
        """A uniform draw in [0, 1) that belongs to each place, not to the order of asking."""
        return noise.uniform_at(x, y, self._seed + salt)

    def _patches(self, x: Array, y: Array, side: float, prefix: str) -> list[Placement]:
        shares = self._shares(x, y, side)
        dry = self._cover.sample(self._cover.exposure, x, y) * 0.6 + self._noise(x, y, 320.0, 401) > 0.12
        shrubby = shares[:, SHRUB] + 0.35 * shares[:, TREE]
        draw = self._draw(x, y, 403)
        open_ground = (
            (shrubby <= 0.3)
            & (draw < 0.6 * shares[:, GRASS] + 0.85 * shares[:, BARE])
            & (self._noise(x, y, 150.0, 405) > -0.2)
        )
        out = []
        for kind, chosen in (("chaparral", ~dry), ("scrub", dry)):
            out += self._put(prefix + kind, x, y, side, chosen & (shrubby > 0.65))
            out += self._put(prefix + kind + "_half", x, y, side, chosen & (shrubby > 0.3) & (shrubby <= 0.65))
            out += self._put(prefix + kind + "_sparse", x, y, side, chosen & open_ground)
        rocky = self._noise(x, y, 90.0, 423) + self._draw(x, y, 425) > 0.1
        out += self._put(
            prefix + "stones", x, y, side, rocky & (shares[:, BARE] > 0.5) & ~self._cover.on_road(x, y, side)
        )
        if prefix:
            conifer = self._conifers(x, y)
            for kind, chosen in (("far_oak", ~conifer), ("far_conifer", conifer)):
                out += self._put(kind, x, y, side, chosen & (shares[:, TREE] > 0.6))
                out += self._put(
                    kind + "_sparse", x, y, side, chosen & (shares[:, TREE] > 0.2) & (shares[:, TREE] <= 0.6)
                )
            out += self._put("lone_oak", x, y, side, (shares[:, TREE] <= 0.2) & self._lone(x, y, shares, side))
        return out

    def _lone(self, x: Array, y: Array, shares: Array, side: float) -> NDArray[np.bool_]:
        """Single oaks in grass and scrub, fewer in scrub."""
        rate = (side / FAR_PATCH) ** 2 * (0.16 * shares[:, GRASS] + 0.05 * shares[:, SHRUB])
        return np.asarray(self._draw(x, y, 407) < rate, np.bool_)

    def _conifers(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Conifers hold the high, shaded ground in stands."""
        z = self._terrain.surroundings
        level = (z.at(x, y) - z.elevation.mean()) / max(float(z.elevation.std()), 1.0)
        exposure = self._cover.sample(self._cover.exposure, x, y)
        return np.asarray(0.5 * level - 0.5 * exposure + 0.9 * self._noise(x, y, 500.0, 409) > 0.55, np.bool_)

    def _trees(self, eye: Array) -> list[Placement]:
        x, y = self._cells(_TREE_SPACING)
        close = np.hypot(x - eye[0], y - eye[1]) < self._config.detail_radius + FAR_PATCH
        x, y = x[close], y[close]
        x = x + (self._draw(x, y, 411) - 0.5) * 0.9 * _TREE_SPACING
        y = y + (self._draw(x, y, 413) - 0.5) * 0.9 * _TREE_SPACING
        # The far patches' own cells decide where detail ends, so that no tree is drawn twice
        g = self._terrain.surroundings.geometry
        cx = g.x_min + np.round((x - g.x_min) / FAR_PATCH) * FAR_PATCH
        cy = g.y_min + np.round((y - g.y_min) / FAR_PATCH) * FAR_PATCH
        near = np.hypot(cx - eye[0], cy - eye[1]) < self._config.detail_radius
        x, y = x[near], y[near]
        shares = np.zeros((len(x), 5))
        shares[np.arange(len(x)), np.minimum(self._cover.at(x, y), 4)] = 1
        dense = (shares[:, TREE] > 0) & (self._draw(x, y, 415) < 0.72)
        stands = dense | self._lone(x, y, shares, _TREE_SPACING)
        # Nothing grows over the camera's own head
        stands &= np.hypot(x - eye[0], y - eye[1]) > 14.0
        conifer = self._conifers(x, y) & dense
        size = 0.65 + 0.6 * self._draw(x, y, 417)
        out = self._put("oak", x, y, 0.0, stands & ~conifer, size)
        return out + self._put("conifer", x, y, 0.0, stands & conifer, size)

    def _tufts(self, eye: Array) -> list[Placement]:
        n = int(self._config.grass_radius / TUFT_PATCH)
        first = np.floor(eye[:2] / TUFT_PATCH) * TUFT_PATCH
        steps = np.arange(-n, n + 1) * TUFT_PATCH
        x, y = (a.ravel() for a in np.meshgrid(first[0] + steps, first[1] + steps))
        close = np.hypot(x - eye[0], y - eye[1]) < self._config.grass_radius
        x, y = x[close], y[close]
        return self._put("tuft", x, y, TUFT_PATCH, self._cover.at(x, y) == GRASS)

    def _put(
        self, name: str, x: Array, y: Array, side: float, chosen: NDArray[np.bool_], size: Array | None = None
    ) -> list[Placement]:
        """Instances of `name` at the chosen points: sheared onto the slope (side > 0), or upright and scaled by
        `size`."""
        if not np.any(chosen):
            return []
        x, y = x[chosen], y[chosen]
        variants = self._prototypes[name]
        which = (self._draw(x, y, 419) * len(variants)).astype(int)
        turn = self._draw(x, y, 421) * 2 * np.pi
        scale = np.ones(len(x)) if size is None else size[chosen]
        slope_x, slope_y = np.zeros(len(x)), np.zeros(len(x))
        if side > 0:
            turn = np.floor(turn / (np.pi / 2)) * (np.pi / 2)
            h = side / 2
            slope_x = (self.ground(x + h, y) - self.ground(x - h, y)) / side
            slope_y = (self.ground(x, y + h) - self.ground(x, y - h)) / side
            corners = [self.ground(x + a * h, y + b * h) for a, b in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))]
            z = 0.5 * corners[0] + 0.125 * sum(corners[1:]) - 0.06
        else:
            z = self.ground(x, y) - 0.1
        c, s = np.cos(turn), np.sin(turn)
        m = np.zeros((len(x), 4, 4))
        m[:, 0, 0], m[:, 0, 1], m[:, 0, 3] = scale * c, -scale * s, x
        m[:, 1, 0], m[:, 1, 1], m[:, 1, 3] = scale * s, scale * c, y
        m[:, 2, 0] = slope_x * c + slope_y * s
        m[:, 2, 1] = -slope_x * s + slope_y * c
        m[:, 2, 2], m[:, 2, 3], m[:, 3, 3] = scale, z, 1.0
        return [Placement(p, m[which == i]) for i, p in enumerate(variants) if np.any(which == i)]
