"""Draws scenarios of one kind that differ by their seed: `ltm-lab simulate tower --seed 31`.

tower       12 masts of 8 to 25 m on knolls, 4 views from each: poses of fixed cameras
pose        8 eyes on knolls and slopes, 4 views from each: poses of cameras anywhere
training    7 eyes, 9 views from each, truth at every pixel, half of the sites with a lake: label networks
felled      a felled stand beside a burnt one, in view of 3 cameras, before and after
conversion  a slope planted with conifers, in view of 2 cameras that each take 4 frames an hour apart
change      one burn, thinning, landslide or cut, in view of 3 cameras, before and after
"""

from typing import Any

import numpy as np
from scipy import ndimage

from ltm_core.base.errors import ConfigError
from ltm_lab.simulator.scenario import GroundConfig, Scenario
from ltm_lab.simulator.terrain_synthesis import HeightField, make_terrain

Rng = np.random.Generator
Values = dict[str, Any]

# fmt: off
RANGES = (
    # key, lengths in m       step  tower             pose              training        felled, conversion, change
    ("terrain.relief",         10, ((420, 640),      (380, 700),       (300, 820),     (220, 300))),
    ("sun.azimuth_deg",         1, ((90, 260),       (100, 280),       (70, 290),      (140, 220))),
    ("sun.elevation_deg",       1, ((26, 56),        (32, 58),         (18, 65),       (40, 55))),
    ("sun.turbidity",         0.5, ((2, 4),          (2, 4),           (2.5, 5),       (2.5, 3.5))),
    ("atmosphere.visibility", 500, ((25_000, 50_000), (14_000, 40_000), (7000, 22_000), (12_000, 16_000))),
    ("vegetation.green",     0.01, ((0.12, 0.22),    (0.10, 0.24),     (0.0, 0.75),    (0.15, 0.35))),
    ("vegetation.tree",      0.01, ((0.14, 0.22),    (0.11, 0.22),     (0.18, 0.30),   (0.35, 0.55))),
    ("vegetation.grass",     0.01, ((0.26, 0.33),    (0.25, 0.37),     (0.20, 0.34),   (0.15, 0.30))),
    ("vegetation.bare",      0.01, ((0.06, 0.06),    (0.03, 0.07),     (0.05, 0.20),   (0.07, 0.07))),
    ("vegetation.conifers",   0.1, ((0.5, 0.5),      (0.5, 0.5),       (0.4, 0.7),     (0.5, 0.5))),
    ("vegetation.houses",       1, ((0, 0),          (0, 0),           (0, 160),       (0, 0))),
)
"""The closed range from which each kind draws each value, evenly, in multiples of the step, unless KINDS fixes it."""
# fmt: on

_POSES: Values = {
    "image": {"width": 640, "height": 360},
    "truth_step": 2,
    "imaging": {"samples": 5},
    "terrain": {"size": 3000.0, "resolution": 4.0, "surroundings": 8192.0},
    "vegetation": {"detail_radius": 500.0, "grass_radius": 60.0},
}
_VIEWS: Values = {"views": 4, "pitch_deg": (-9.0, 4.0), "roll_deg": (-3.0, 3.0), "hfov_deg": (40.0, 66.0)}
_CHANGED: Values = {
    "image": {"width": 640, "height": 360},
    "truth_step": 2,
    "imaging": {"samples": 6},
    "terrain": {"size": 1200.0, "resolution": 2.0, "surroundings": 4096.0},
    "vegetation": {"detail_radius": 700.0, "grass_radius": 120.0, "growing": False},
    "dem": {"resolution": 2.0, "sigma": 0.15},
    "dates": [{"name": "before"}, {"name": "after", "years": 1.0}],
}
KINDS: dict[str, tuple[int, Values]] = {
    "tower": (0, _POSES | {"views": _VIEWS | {"positions": 12, "slopes": False, "mast": (8.0, 25.0)}}),
    "pose": (1, _POSES | {"views": _VIEWS | {"positions": 8}}),
    "training": (
        2,
        {
            "image": {"width": 512, "height": 288},
            "truth_step": 1,
            "curvature": False,
            "imaging": {"samples": 10},
            "vegetation": {"detail_radius": 700.0, "grass_radius": 150.0},
            "views": {"positions": 7, "views": 9},
        },
    ),
    "felled": (3, _CHANGED),
    "conversion": (
        3,
        _CHANGED
        | {
            "image": {"width": 960, "height": 540},
            "terrain": {"size": 1500.0, "resolution": 3.0, "surroundings": 4096.0},
            "vegetation": _CHANGED["vegetation"] | {"tree": 0.1},
            "dates": [{"name": "before", "frames": False}, {"name": "after", "years": 12.0}],
        },
    ),
    "change": (3, _CHANGED),
}
"""The column of RANGES that each kind draws from, and the values that all its scenarios have."""

_MAST = 25.0  # m
_FANS = 8  # directions drawn for the cameras that watch a change; the one whose worst camera sees best is taken
_PLACES = 40  # drawn for each of them; the one with the best sight is taken


def draw_scenario(kind: str, seed: int) -> Scenario:
    """Return the scenario of one of KINDS that `seed` draws; the same two give the same scenario.

    Raises ConfigError on an unknown kind or a negative seed.
    """
    if kind not in KINDS:
        raise ConfigError(f"{kind!r} is not a kind of scenario; give one of {', '.join(KINDS)}")
    if seed < 0:
        raise ConfigError(f"the seed is {seed}; give 0 or more")
    rng = np.random.default_rng([seed, *kind.encode()])
    column, fixed = KINDS[kind]
    values = dict(fixed)
    for key, step, ranges in RANGES:
        low, high = ranges[column]
        group, name = key.split(".")
        drawn = low + step * int(rng.integers(round((high - low) / step) + 1))
        values[group] = {name: round(drawn, 2)} | values.get(group, {})
    if kind == "training" and rng.uniform() < 0.5:
        values["lakes"] = [_lake(rng, _ground(values, seed))]
    if "dates" in values:
        ground = _ground(values, seed)
        x, y = (float(v) for v in np.rint(ground.geometry.x_max * rng.uniform(0.45, 0.55, 2)))
        values["changes"] = _changes(kind, rng, x, y)
        values["cameras"] = _cameras(kind, rng, ground, x, y)
    return Scenario(name=f"{kind}_{seed}", seed=seed, **values)


def _ground(values: Values, seed: int) -> HeightField:
    return make_terrain(GroundConfig(**values["terrain"]), seed).site


def _lake(rng: Rng, ground: HeightField) -> Values:
    """Return a lake in the deepest hollow away from the site's border."""
    g = ground.geometry
    hollow = ground.elevation - ndimage.gaussian_filter(ground.elevation, 250.0 / g.resolution)
    margin = g.width // 5
    inner = hollow[margin:-margin, margin:-margin]
    row, col = (int(i) + margin for i in np.unravel_index(np.argmin(inner), inner.shape))
    x, y = (float(v) for v in g.to_map(row, col))
    return {"x": x, "y": y, "depth": float(rng.integers(10, 17)), "radius": float(rng.integers(200, 321))}


def _changes(kind: str, rng: Rng, x: float, y: float) -> list[Values]:
    """Return what happens about map (x, y)."""
    if kind == "felled":
        felled, burnt = ({"box": [x + side, y - 50, x + side + 65, y + 50], "ragged": 6} for side in (-70, 5))
        return [
            {"kind": "conversion", "to": "grass", "of": ["shrub", "tree"], "years": 0.5, "mask": felled},
            {"kind": "burn", "severity": 0.85, "years": 0.9, "mask": burnt},
        ]
    if kind == "conversion":
        mask: Values = {"box": [x - 300, y - 250, x + 300, y + 250]}
        return [{"kind": "conversion", "to": "conifer", "age": 25, "years": 2.0, "mask": mask}]
    drawn = (
        {"kind": "burn", "severity": round(rng.uniform(0.6, 1.0), 2)},
        {"kind": "thinning", "keep": round(rng.uniform(0.2, 0.4), 2), "of": ["shrub", "tree"]},
        {"kind": "landslide", "depth": round(rng.uniform(5.0, 9.0), 1)},
        {"kind": "cut", "depth": round(float(rng.choice([-1, 1]) * rng.uniform(3.0, 6.0)), 1)},
    )[int(rng.integers(4))]
    mask = {"circle": [x, y, float(rng.integers(40, 81))], "ragged": 6}
    return [drawn | {"years": 0.5, "mask": mask}]


def _cameras(kind: str, rng: Rng, ground: HeightField, x: float, y: float) -> list[Values]:
    """Return cameras on masts that look at map (x, y) from directions 30 degrees apart."""
    fans = [_fan(kind, rng, ground, x, y) for _ in range(_FANS)]
    return max(fans, key=lambda fan: fan[0])[1]


def _fan(kind: str, rng: Rng, ground: HeightField, x: float, y: float) -> tuple[float, list[Values]]:
    """Return cameras in one drawn direction, and the least clearance (m) of their lines of sight above the ground."""
    count, reach = (2, (400.0, 600.0)) if kind == "conversion" else (3, (170.0, 320.0))
    first, middle, worst = rng.uniform(0, 360), float(ground.at(x, y)), np.inf
    cameras = []
    for k in range(count):
        turn = np.radians(first + 30 * k + rng.uniform(-12, 12, _PLACES))
        away = rng.uniform(*reach, _PLACES)
        east, north = np.rint(x - away * np.sin(turn)), np.rint(y - away * np.cos(turn))
        up = ground.at(east, north) + _MAST
        # To a point 8 m over the middle
        t = np.linspace(0.05, 0.95, 40)[:, None]
        below = ground.at(east + (x - east) * t, north + (y - north) * t)
        clearance = (up + (middle + 8 - up) * t - below).min(axis=0)
        best = int(np.argmax(clearance))
        worst = min(worst, float(clearance[best]))
        azimuth = round(float(np.degrees(np.arctan2(x - east[best], y - north[best]))) % 360, 1)
        pitch = round(float(np.degrees(np.arctan2(middle - up[best], away[best]))), 1)
        patrol: Values = {"azimuth_deg": [azimuth], "pitch_deg": [pitch]}
        if kind == "conversion":
            sides = [round((azimuth + side) % 360, 1) for side in (-13, 13)]
            patrol |= {"azimuth_deg": sides, "rounds": 2, "interval_s": 3600.0}
        place = {"x": float(east[best]), "y": float(north[best])}
        cameras.append({"name": f"tower_{'abc'[k]}", "mast": _MAST, "hfov_deg": 55.0, "patrol": patrol} | place)
    return worst, cameras
