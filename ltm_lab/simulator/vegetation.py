"""Places plants: instances of the prototypes, by the land cover and the seed."""

from dataclasses import dataclass

import numpy as np

from ltm_core.base.types import BoolArray, Float64Array, Int64Array
from ltm_lab.simulator import noise_fields
from ltm_lab.simulator.appearance import Reflectances
from ltm_lab.simulator.ground_mesh import line_of_sight
from ltm_lab.simulator.landcover import BARE, BUILT, GRASS, SHRUB, TREE, LandCover, PlantCells, describe
from ltm_lab.simulator.prototypes import FAR_PATCH, NEAR_PATCH, STAGES, TUFT_PATCH, Prototype, prototypes
from ltm_lab.simulator.scenario import VegetationConfig
from ltm_lab.simulator.terrain_synthesis import SyntheticTerrain

LATTICE = 0.25  # m; trees stand on it, so that their heights can be counted on it exactly
_TREE_SPACING = 8.5  # m, jittered grid
_GAP, _CLOSE = 9.0, 55.0  # m from the eye: no shrub within the first, single leaves within the second
_CLOSE_GRASS = 28.0  # m
_TURNS = 8  # directions a tree is turned to
_SEEDLING = 0.15  # plants smaller than this share of mature ones are not drawn


@dataclass(frozen=True)
class Placement:
    """Instances of one prototype: `transforms` (N, 4, 4), prototype to map."""

    prototype: Prototype
    transforms: Float64Array


def _keys(x: Float64Array, y: Float64Array) -> Int64Array:
    """One number for each metre's square of the map."""
    return np.asarray(np.rint(x).astype(np.int64) * 2**32 + np.rint(y).astype(np.int64), np.int64)


class Planting:
    """Where plants stand. Placement is a function of the ground and the seed; the eye only chooses the level of
    detail."""

    def __init__(
        self, terrain: SyntheticTerrain, cover: LandCover, config: VegetationConfig, colors: Reflectances, seed: int
    ) -> None:
        self._terrain = terrain
        self._cover = cover
        self._config = config
        self._seed = seed
        self._prototypes = prototypes(colors, seed)

    def ground(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """Height of the ground that is rendered at map points: the site's inside it, the surroundings' outside."""
        g = self._terrain.site.geometry
        half = g.resolution / 2
        inside = (x >= g.x_min + half) & (x <= g.x_max - half) & (y >= g.y_min + half) & (y <= g.y_max - half)
        return np.where(inside, self._terrain.site.at(x, y), self._terrain.surroundings.at(x, y))

    def around(self, eye: Float64Array, bend: float = 0.0) -> list[Placement]:
        """All instances for a camera at map point `eye` (3,) but those that ridges hide from it; `bend`: metres that
        the earth sinks a square metre of distance."""
        x, y = self._centers(FAR_PATCH)
        sight = line_of_sight(self._terrain.surroundings, eye, FAR_PATCH, bend).at(x, y)
        x, y = x[sight], y[sight]
        near = np.hypot(x - eye[0], y - eye[1]) < self._config.detail_radius
        out = self._patches(describe(self._cover, x[~near], y[~near], FAR_PATCH), "far_")
        out += self._detailed(x[near], y[near], eye) + self._houses()
        if self._config.grass_radius > 0:
            out += self._tufts(eye)
        return out

    def everywhere(self) -> list[Placement]:
        """All shrubs, trees and houses that stand on the site, in full detail; no grass, no stones."""
        x, y = self._centers(FAR_PATCH)
        x_min, y_min, x_max, y_max = self._terrain.site.geometry.bounds
        over = FAR_PATCH
        on_site = (x > x_min - over) & (x < x_max + over) & (y > y_min - over) & (y < y_max + over)
        placed = self._detailed(x[on_site], y[on_site], None)
        return [p for p in placed if p.prototype.class_id in (SHRUB, TREE, BUILT)]

    def _detailed(self, x: Float64Array, y: Float64Array, eye: Float64Array | None) -> list[Placement]:
        """Near patches and single trees over the far cells centred at (x, y)."""
        quarter = np.array([-0.25, 0.25]) * FAR_PATCH
        x_near = (x[:, None] + np.array([quarter[0], quarter[1], quarter[0], quarter[1]])).ravel()
        y_near = (y[:, None] + np.array([quarter[0], quarter[0], quarter[1], quarter[1]])).ravel()
        out = self._trees(x, y, eye) + (self._houses() if eye is None else [])
        if eye is not None:
            reach = np.hypot(np.hypot(x_near - eye[0], y_near - eye[1]), eye[2] - self.ground(x_near, y_near))
            # A person stands in a gap, not inside a shrub
            open_to_eye = reach > _GAP
            close = open_to_eye & (reach < _CLOSE)
            out += self._patches(describe(self._cover, x_near[close], y_near[close], NEAR_PATCH), "close_")
            x_near, y_near = x_near[open_to_eye & ~close], y_near[open_to_eye & ~close]
        return out + self._patches(describe(self._cover, x_near, y_near, NEAR_PATCH), "")

    def _centers(self, side: float) -> tuple[Float64Array, Float64Array]:
        """Centres of the square cells of `side` over the surroundings, less a margin."""
        g = self._terrain.surroundings.geometry
        xs = np.arange(g.x_min + 2 * side, g.x_max - 2 * side, side)
        ys = np.arange(g.y_min + 2 * side, g.y_max - 2 * side, side)
        x, y = np.meshgrid(xs, ys)
        return x.ravel(), y.ravel()

    def _noise(self, x: Float64Array, y: Float64Array, wavelength: float, salt: int) -> Float64Array:
        """Noise in [-1, 1] at scattered points."""
        return noise_fields.at_points(x, y, wavelength, self._seed + salt)

    def _draw(self, x: Float64Array, y: Float64Array, salt: int) -> Float64Array:
        """A uniform draw in [0, 1) that belongs to each place, not to the order of asking."""
        return noise_fields.uniform_at(x, y, self._seed + salt)

    def _dry(self, x: Float64Array, y: Float64Array) -> BoolArray:
        """Where low scrub stands in place of tall chaparral."""
        exposure = self._cover.sample(self._cover.exposure, x, y) * 0.6
        return np.asarray(exposure + self._noise(x, y, 320.0, 401) > 0.62 - self._config.scrub, np.bool_)

    def _patches(self, c: PlantCells, prefix: str) -> list[Placement]:
        dry = self._dry(c.x, c.y)
        grass, bare, tree = c.shares[:, GRASS], c.shares[:, BARE], c.shares[:, TREE] * np.minimum(c.density, 1.0)
        shrubby = (c.shares[:, SHRUB] + 0.35 * c.shares[:, TREE]) * c.density
        grown = c.shrub_height > _SEEDLING
        open_ground = (
            (shrubby <= 0.3)
            & (self._draw(c.x, c.y, 403) < (0.6 * grass + 0.85 * bare * c.rock) * np.minimum(c.density, 1))
            & (self._noise(c.x, c.y, 150.0, 405) > -0.2)
            & (c.char < 0.3)
        )
        out = self._singly(c, prefix)
        grown &= ~c.edge
        for kind, chosen in (("chaparral", ~dry & grown), ("scrub", dry & grown)):
            for suffix, where in (
                ("", shrubby > 0.65),
                ("_half", (shrubby > 0.3) & (shrubby <= 0.65)),
                ("_sparse", open_ground),
            ):
                out += self._put_by_stage(prefix + kind + suffix, c, chosen & where)
        rocky = self._noise(c.x, c.y, 90.0, 423) + self._draw(c.x, c.y, 425) > 0.1
        rocky &= (bare * c.rock > 0.5) & ~self._cover.on_road(c.x, c.y, c.side)
        coarse = prefix.removeprefix("close_")
        out += self._put(coarse + "stones", c.x, c.y, c.side, rocky)
        out += self._put(coarse + "sticks", c.x, c.y, c.side, c.dead_shrub & (c.char > 0.1))
        if coarse:
            out += self._put("far_snag", c.x, c.y, c.side, c.dead_tree)
            alive = (c.tree_height > _SEEDLING) & ~c.dead_tree
            burnt = c.scorch > 0.5
            for kind, kin in (("far_oak", alive & ~c.conifer), ("far_conifer", alive & c.conifer)):
                for suffix, where in (("", tree > 0.6), ("_sparse", (tree > 0.2) & (tree <= 0.6))):
                    out += self._put_by_stage(kind + suffix, c, kin & where & ~burnt, trees=True)
                    out += self._put_by_stage(kind + suffix + "_scorched", c, kin & where & burnt, trees=True)
            out += self._put("lone_oak", c.x, c.y, c.side, alive & (tree <= 0.2) & self._lone(c))
        return out

    def _inside(self, c: PlantCells, chosen: BoolArray, spacing: float, salt: int) -> tuple[Float64Array, Float64Array]:
        """Points (N,) of a jittered grid of about `spacing` over the chosen cells."""
        n = max(1, round(c.side / spacing))
        steps = ((np.arange(n) + 0.5) / n - 0.5) * c.side
        dx, dy = (a.ravel() for a in np.meshgrid(steps, steps))
        x, y = (c.x[chosen, None] + dx).ravel(), (c.y[chosen, None] + dy).ravel()
        stride = 0.9 * c.side / n
        return x + stride * (self._draw(x, y, salt) - 0.5), y + stride * (self._draw(x, y, salt + 1) - 0.5)

    def _singly(self, c: PlantCells, prefix: str) -> list[Placement]:
        """Shrubs one by one over cells in which a change has ended: whole patches would draw its edge straight."""
        if not np.any(c.edge):
            return []
        x, y = self._inside(c, c.edge, 2.0 if prefix == "far_" else 1.5, 431)
        x, y = np.rint(x / LATTICE) * LATTICE, np.rint(y / LATTICE) * LATTICE
        # Edges of the land cover's cells, too, are wound
        wound = [5.0 * self._noise(x, y, 17.0, salt) for salt in (435, 437)]
        at = describe(self._cover, x + wound[0], y + wound[1], c.side, samples=1)
        rate = 0.94 * (at.shares[:, SHRUB] + 0.35 * at.shares[:, TREE]) * np.minimum(at.density, 1.0)
        stands = (self._draw(x, y, 439) < rate) & (at.shrub_height > _SEEDLING)
        dry = self._dry(x, y)
        stage = np.abs(at.shrub_height[:, None] - np.array(STAGES)).argmin(axis=1)
        out = []
        for kind, chosen in (("chaparral", stands & ~dry), ("scrub", stands & dry)):
            for i in np.unique(stage[chosen]):
                name = f"{prefix}{kind}_one@{round(100 * STAGES[i])}"
                out += self._put(name, x, y, 0.0, chosen & (stage == i), np.ones(len(x)))
        return out

    def _houses(self) -> list[Placement]:
        houses = self._cover.houses
        x, y = np.rint(houses.x / LATTICE) * LATTICE, np.rint(houses.y / LATTICE) * LATTICE
        standing = self._cover.at(x, y) == BUILT
        return self._put("house", x, y, 0.0, standing, np.ones(len(x)))

    def _lone(self, c: PlantCells) -> BoolArray:
        """Single oaks in grass and scrub, fewer in scrub."""
        open_land = c.shares[:, GRASS] + c.shares[:, BARE] * (c.char > 0.1)
        rate = (c.side / FAR_PATCH) ** 2 * (0.16 * open_land + 0.05 * c.shares[:, SHRUB]) * np.minimum(c.density, 1)
        return np.asarray(self._draw(c.x, c.y, 407) < rate, np.bool_)

    def _trees(self, cell_x: Float64Array, cell_y: Float64Array, eye: Float64Array | None) -> list[Placement]:
        """Single trees over the far cells centred at (cell_x, cell_y)."""
        g = self._terrain.surroundings.geometry
        wanted = _keys(cell_x, cell_y)
        x, y = self._centers(_TREE_SPACING)
        if eye is not None:
            close = np.hypot(x - eye[0], y - eye[1]) < self._config.detail_radius + FAR_PATCH
            x, y = x[close], y[close]
        x = x + (self._draw(x, y, 411) - 0.5) * 0.9 * _TREE_SPACING
        y = y + (self._draw(x, y, 413) - 0.5) * 0.9 * _TREE_SPACING
        x, y = np.rint(x / LATTICE) * LATTICE, np.rint(y / LATTICE) * LATTICE
        # The far patches' own cells decide where detail ends, so that no tree is drawn twice
        cx = g.x_min + np.round((x - g.x_min) / FAR_PATCH) * FAR_PATCH
        cy = g.y_min + np.round((y - g.y_min) / FAR_PATCH) * FAR_PATCH
        near = np.isin(_keys(cx, cy), wanted)
        c = describe(self._cover, x[near], y[near], _TREE_SPACING, samples=1)
        closed = self._draw(c.x, c.y, 415) < 0.72 * c.density
        dense = (c.shares[:, TREE] > 0) & closed
        stands = (dense | self._lone(c)) & (c.tree_height > _SEEDLING)
        # Nothing grows over the camera's own head
        clear = np.ones(len(c.x), bool) if eye is None else np.hypot(c.x - eye[0], c.y - eye[1]) > 14.0
        yards = self._cover.houses
        for hx, hy in zip(yards.x, yards.y, strict=True):
            clear &= np.hypot(c.x - hx, c.y - hy) > 9.0
        stands &= clear
        conifer = c.conifer & dense
        size = (0.65 + 0.6 * self._draw(c.x, c.y, 417)) * c.tree_height
        out = self._put("snag", c.x, c.y, 0.0, c.dead_tree & closed & clear, np.ones(len(c.x)))
        for suffix, low, high in (("", -1.0, 0.3), ("_singed", 0.3, 0.75), ("_scorched", 0.75, 2.0)):
            state = stands & (c.scorch > low) & (c.scorch <= high)
            out += self._put("oak" + suffix, c.x, c.y, 0.0, state & ~conifer, size)
            out += self._put("conifer" + suffix, c.x, c.y, 0.0, state & conifer, size)
        return out

    def _tufts(self, eye: Float64Array) -> list[Placement]:
        n = int(self._config.grass_radius / TUFT_PATCH)
        first = np.floor(eye[:2] / TUFT_PATCH) * TUFT_PATCH
        steps = np.arange(-n, n + 1) * TUFT_PATCH
        x, y = (a.ravel() for a in np.meshgrid(first[0] + steps, first[1] + steps))
        close = np.hypot(x - eye[0], y - eye[1]) < self._config.grass_radius
        x, y = x[close], y[close]
        grass = self._cover.at(x, y) == GRASS
        close_by = np.hypot(x - eye[0], y - eye[1]) < _CLOSE_GRASS
        out = self._put("tuft", x, y, TUFT_PATCH, grass & ~close_by)
        # Dry herbs and litter stand between shrubs too
        some = grass | ((self._draw(x, y, 427) < 0.4) & (self._cover.sample(self._cover.stand.char, x, y) < 0.1))
        return out + self._put("close_tuft", x, y, TUFT_PATCH, some & close_by)

    def _put_by_stage(self, name: str, c: PlantCells, chosen: BoolArray, trees: bool = False) -> list[Placement]:
        """Patches of `name`, each at the stage of growth nearest to its cell's."""
        height = c.tree_height if trees else c.shrub_height
        stage = np.abs(height[:, None] - np.array(STAGES)).argmin(axis=1)
        out = []
        for i in np.unique(stage[chosen]):
            out += self._put(f"{name}@{round(100 * STAGES[i])}", c.x, c.y, c.side, chosen & (stage == i))
        return out

    def _put(
        self,
        name: str,
        x: Float64Array,
        y: Float64Array,
        side: float,
        chosen: BoolArray,
        size: Float64Array | None = None,
    ) -> list[Placement]:
        """Instances of `name` at the chosen points: sheared onto the slope (side > 0), or upright and scaled by
        `size`."""
        if not np.any(chosen):
            return []
        x, y = x[chosen], y[chosen]
        variants = self._prototypes[name]
        which = (self._draw(x, y, 419) * len(variants)).astype(int)
        turns = 4 if side > 0 else _TURNS
        turn = np.floor(self._draw(x, y, 421) * turns) * (2 * np.pi / turns)
        scale = np.ones(len(x)) if size is None else np.maximum(np.rint(size[chosen] * 20) / 20, 0.05)
        slope_x, slope_y = np.zeros(len(x)), np.zeros(len(x))
        if side > 0:
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
