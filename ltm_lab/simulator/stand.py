"""State of the vegetation in each cell, aged by years and altered by a scenario's changes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator import noise_fields
from ltm_lab.simulator.changes import Burn, Change, Conversion, Cut, Landslide, MaskConfig, Thinning
from ltm_lab.simulator.landcover import BARE, GRASS, SHRUB, TREE, LandCover, Stand
from ltm_lab.simulator.terrain_synthesis import HeightField, SyntheticTerrain, axes

_CLASS_OF = {"conifer": TREE, "oak": TREE, "tree": TREE, "shrub": SHRUB, "grass": GRASS, "bare": BARE}
_HERBS, _RESPROUTS = 0.4, 3.0  # years after a fire
_CHAR_FADES = 0.8  # years, 1/e
_SHRUB_TIME, _TREE_TIME = 9.0, 35.0  # years, 1/e of height growth
_SHRUB_AGE, _TREE_AGE = 25.0, 60.0  # years at which a stand counts as mature
_TREE_LEAD = _TREE_AGE - _SHRUB_AGE  # trees of an undisturbed site are so much older than its shrubs
_GONE = 0.3  # density below which a cell is no longer of its plants' class


def mask_weights(mask: MaskConfig, geometry: GridGeometry, seed: int) -> BoolArray:
    """The cells (H, W) of `geometry` (map frame) that a mask covers, its edge made ragged by seeded noise."""
    xs, ys = axes(geometry)
    x, y = np.meshgrid(xs, ys)
    if mask.ragged > 0:
        x = x + 1.6 * mask.ragged * noise_fields.fractal(xs, ys, 90.0, seed + 701, octaves=4, gain=0.6)
        y = y + 1.6 * mask.ragged * noise_fields.fractal(xs, ys, 90.0, seed + 703, octaves=4, gain=0.6)
    if mask.circle is not None:
        cx, cy, radius = mask.circle
        return np.asarray(np.hypot(x - cx, y - cy) <= radius, np.bool_)
    if mask.box is not None:
        x_min, y_min, x_max, y_max = mask.box
        return np.asarray((x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max), np.bool_)
    assert mask.polygon is not None  # nosec B101 # tells the type checker what holds
    inside = np.zeros(geometry.shape, bool)
    corners = np.array(mask.polygon, np.float64)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if y0 != y1:
            crosses = (y0 > y) != (y1 > y)
            inside ^= crosses & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return inside


def changed_terrain(terrain: SyntheticTerrain, changes: Sequence[Change], years: float, seed: int) -> SyntheticTerrain:
    """The ground as landslides and cuts up to `years` have left it; the same object where there were none."""
    site = terrain.site
    for change in _past(changes, years):
        if isinstance(change, Landslide | Cut):
            inside = mask_weights(change.mask, site.geometry, seed)
            dz = _slide(site, inside, change) if isinstance(change, Landslide) else _cut(site, inside, change)
            site = HeightField((site.elevation + dz).astype(np.float32), site.geometry)
    if site is terrain.site:
        return terrain
    delta = HeightField(site.elevation - terrain.site.elevation, site.geometry)
    wide = terrain.surroundings
    x, y = np.meshgrid(*wide.axes())
    g = site.geometry
    over = (x > g.x_min) & (x < g.x_max) & (y > g.y_min) & (y < g.y_max)
    elevation = wide.elevation + np.where(over, delta.at(x, y), 0.0)
    return SyntheticTerrain(site, HeightField(elevation.astype(np.float32), wide.geometry), terrain.wetness)


def _depth_inside(inside: BoolArray, cell: float) -> Float32Array:
    """Metres from the mask's edge (H, W), 0 outside."""
    return np.asarray(cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, 5) * cell, np.float32)


def _slide(site: HeightField, inside: BoolArray, change: Landslide) -> Float32Array:
    out = np.zeros(inside.shape, np.float32)
    if not np.any(inside):
        return out
    within = _depth_inside(inside, site.geometry.resolution)
    bowl = np.sqrt(np.clip(within / max(float(within.max()), 1e-6), 0, 1))
    z = site.elevation[inside]
    low, high = np.quantile(z, [0.02, 0.98])
    height = np.clip((site.elevation - low) / max(float(high - low), 1e-6), 0, 1)
    scar = bowl * np.clip((height - 0.42) / 0.3, 0, 1) * inside
    scar /= max(float(scar.max()), 1e-6)
    toe = bowl * np.clip((0.42 - height) / 0.25, 0, 1) * inside
    lumps = 1 + 0.35 * noise_fields.fractal(*site.axes(), 22.0, 733, octaves=3, gain=0.6)
    out -= change.depth * scar
    if toe.sum() > 0:
        out += change.depth * change.deposit * float(scar.sum() / toe.sum()) * toe * lumps
    return out.astype(np.float32)


def _cut(site: HeightField, inside: BoolArray, change: Cut) -> Float32Array:
    return np.asarray(
        -change.depth * np.clip(_depth_inside(inside, site.geometry.resolution) / change.ramp, 0, 1), np.float32
    )


def stand_at(
    cover: LandCover, changes: Sequence[Change], years: float, age: float, growing: bool, seed: int
) -> LandCover:
    """The cover as it stands `years` after the scenario's start.

    `cover` is the undisturbed one, its shrubs `age` years old at the start; `growing` says whether undisturbed
    plants age with the dates. Places that no change touches keep their class and their plants.
    """
    shape = cover.geometry.shape
    grown = np.full(shape, age + growing * years, np.float32)
    names = ("density", "conifer", "char", "scorch", "dead", "rock", "touched")
    state = _State(
        cover.classes.copy(), grown, grown + _TREE_LEAD, {name: getattr(cover.stand, name).copy() for name in names}
    )
    for number, change in enumerate(_past(changes, years)):
        inside = mask_weights(change.mask, cover.geometry, seed)
        old = [a.copy() for a in (state.classes, state.shrub_age, state.fields["density"])]
        _apply(state, change, inside, years - change.years, cover.geometry, seed + 13 * number)
        new = (state.classes, state.shrub_age, state.fields["density"])
        if not isinstance(change, Conversion):  # which leaves no edge between plants and open ground
            acted = np.any([a != b for a, b in zip(old, new, strict=True)], axis=0)
            state.fields["touched"][acted] = number + 1
    sparse = (state.fields["density"] < _GONE) & np.isin(state.classes, (SHRUB, TREE))
    state.classes[sparse] = GRASS
    shrub = _height(state.shrub_age, _SHRUB_TIME, _SHRUB_AGE)
    tree = _height(state.tree_age, _TREE_TIME, _TREE_AGE)
    return replace(cover, classes=state.classes, stand=Stand(shrub_height=shrub, tree_height=tree, **state.fields))


def _height(age: Float32Array, time: float, mature: float) -> Float32Array:
    """Height relative to a mature stand."""
    return np.asarray((1 - np.exp(-np.maximum(age, 0.3) / time)) / (1 - np.exp(-mature / time)), np.float32)


def _past(changes: Sequence[Change], years: float) -> list[Change]:
    return sorted((c for c in changes if c.years <= years), key=lambda c: c.years)


@dataclass
class _State:
    classes: UInt8Array
    shrub_age: Float32Array
    tree_age: Float32Array
    fields: dict[str, Any]


def _apply(s: _State, change: Change, inside: BoolArray, since: float, geometry: GridGeometry, seed: int) -> None:
    """Change the state where `inside`, as it is `since` years after the change."""
    if isinstance(change, Burn):
        return _burn(s, change, inside, since, geometry, seed)
    if isinstance(change, Thinning | Conversion):
        inside = inside & np.isin(s.classes, [_CLASS_OF[c] for c in change.of])
    if isinstance(change, Thinning):
        s.fields["density"][inside] *= change.keep
        return None
    s.fields["dead"][inside] = 0
    if isinstance(change, Conversion):
        s.classes[inside] = _CLASS_OF[change.to]
        s.shrub_age[inside] = s.tree_age[inside] = change.age + since
        s.fields["conifer"][inside] = change.to == "conifer"
        s.fields["density"][inside] = 1.0
        s.fields["rock"][inside] = change.to == "bare"
    else:
        s.classes[inside] = BARE
        s.fields["density"][inside] = s.fields["char"][inside] = 0.0
        s.fields["rock"][inside] = isinstance(change, Landslide)
    return None


def _burn(s: _State, change: Burn, inside: BoolArray, since: float, geometry: GridGeometry, seed: int) -> None:
    xs, ys = axes(geometry)
    uneven = noise_fields.fractal(xs, ys, 130.0, seed + 711, octaves=4, gain=0.65)
    severity = np.clip(change.severity + 0.5 * uneven, 0, 1)
    burnt = inside & (severity > 0.12)
    severity = np.where(burnt, severity, 0).astype(np.float32)
    tree = burnt & (s.classes == TREE)
    killed = tree & (severity > 0.7)
    opened = burnt & (s.classes != BARE) & (~tree | killed)
    was_shrub = opened & (s.classes != GRASS)
    if since < _HERBS:
        s.classes[opened] = BARE
    else:
        s.classes[opened] = GRASS
        if since >= _RESPROUTS:
            s.classes[was_shrub] = SHRUB
    s.shrub_age[opened] = since
    s.tree_age[killed] = since
    s.fields["dead"][was_shrub] = SHRUB
    s.fields["dead"][killed] = TREE
    crown = np.clip((severity - 0.15) / 0.45, 0, 1)
    s.fields["scorch"] = np.where(burnt & ~killed, crown * max(0.0, 1 - since / 2), s.fields["scorch"]).astype(
        np.float32
    )
    faded = np.exp(-since / _CHAR_FADES)
    s.fields["char"] = np.maximum(s.fields["char"], np.sqrt(severity) * faded).astype(np.float32)
    s.fields["char"] = ndimage.gaussian_filter(s.fields["char"], 0.5).astype(np.float32)
