"""Runs smoke trials on a site and scores the places that are found: error, coverage, disagreement."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from ltm_core.base.errors import RegionError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.geodesy import ray_bend
from ltm_core.locating.locator import Location, Locator
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sighting import Sighting
from ltm_core.visibility.point_visibility import PointVisibility
from ltm_lab.evaluation.locating.smoke_sites import MAST, SmokeSite
from ltm_lab.evaluation.locating.smoke_trials import PoseErrors, SeenPlume, random_plume, seen_plume, sighting

NEAREST, FARTHEST = 800.0, 10_000.0
"""Metres from a tower to smoke."""
_WIDE, APART, _TOGETHER = 30.0, 15.0, 5.0
"""Degrees at the foot: two cameras that cross well, three that are told apart, two from one direction."""
TURNED_DEG = 2.0
"""By which a camera is turned without anybody's knowledge."""
_BESIDE = 60.0, 160.0
"""Metres between two towers that look from one direction."""


Drawer = Callable[[Location, Sequence[Sighting], tuple[float, float]], None]


class Case(StrEnum):
    ONE = "one camera"
    TWO = "two cameras, 30 deg and more apart"
    SAME = "two cameras from one direction"
    THREE = "three cameras"
    TURNED = "three cameras, one turned by 2 deg"


@dataclass(frozen=True)
class Trial:
    """One trial's outcome. `error`: of the posterior's mean, metres; `likeliest_error`: of its
    likeliest place. `range`: mean of the cameras'. `hidden`: metres of
    the plume that the camera that sees it best does not see. `densest`: the share of the densest region that the truth
    lies at the edge of. `in_50`, `in_95`: whether the ellipses hold it. `major`, `minor`: half axes of the 95 % one.
    `named`: the camera taken for wrong. `unlocated`: why there is no answer.
    """

    site: str
    case: str
    boxed: bool
    range: float
    hidden: float
    error: float
    likeliest_error: float
    densest: float
    in_50: bool
    in_95: bool
    major: float
    minor: float
    modes: int
    agreed: bool
    named: str
    wrong: str
    milliseconds: float
    unlocated: str = ""

    def row(self) -> dict[str, Any]:
        """For JSON."""
        return {key: value if value == value else None for key, value in asdict(self).items()}


def smoke_trials(
    site: SmokeSite,
    cases: tuple[Case, ...],
    count: int,
    errors: PoseErrors,
    config: LocatingConfig,
    boxed: bool,
    seed: int,
    curvature: bool = True,
    drawer: Drawer | None = None,
) -> Iterator[Trial]:
    """`count` trials of each case on a site. `drawer`: is shown each answer, its sightings, and the truth."""
    bend = ray_bend(curvature, 0.13)
    sight = PointVisibility(site.truth, curvature)
    locator = Locator(site.model, bend, config)
    for case in cases:
        rng = np.random.default_rng([seed, list(Case).index(case), int(boxed)])
        done = 0
        for _ in range(count * 400):
            if done == count:
                break
            views = views_of_case(rng, site, sight, case)
            if views is None:
                continue
            wrong = int(rng.integers(len(views))) if case is Case.TURNED else -1
            turn = TURNED_DEG * (1 if rng.uniform() < 0.5 else -1)
            marks = [
                sighting(rng, f"camera_{k}", view, bend, errors, config, boxed, turn if k == wrong else 0.0)
                for k, view in enumerate(views)
            ]
            found = [mark for mark in marks if mark is not None]
            if len(found) == len(views):
                done += 1
                yield _score(site.name, case, boxed, locator, views, found, wrong, drawer)


def views_of_case(
    rng: np.random.Generator, site: SmokeSite, sight: PointVisibility, case: Case
) -> list[SeenPlume] | None:
    """Smoke at a random place and the towers of a case that see it; None where they do not."""
    g = site.truth.geometry
    at = rng.uniform([g.x_min + 100, g.y_min + 100], [g.x_max - 100, g.y_max - 100])
    ground = float(site.truth.elevation_at(*at))
    if math.isnan(ground):
        return None
    plume = random_plume(rng, np.array([*at, ground]))
    away = np.hypot(*(site.towers[:, :2] - at).T)
    near = site.towers[(away > NEAREST) & (away < FARTHEST)]
    rng.shuffle(near)
    seen: list[SeenPlume] = []
    wanted = {Case.ONE: 1, Case.TWO: 2, Case.SAME: 1, Case.THREE: 3, Case.TURNED: 3}[case]
    apart = _WIDE if case is Case.TWO else APART
    for tower in near:
        if all(crossing_deg(tower, other.tower, at) >= apart for other in seen):
            view = seen_plume(sight, plume, tower)
            if view is not None:
                seen.append(view)
        if len(seen) == wanted:
            break
    if len(seen) < wanted:
        return None
    if case is Case.SAME:
        angle, distance = rng.uniform(0, 2 * np.pi), rng.uniform(*_BESIDE)
        x, y = seen[0].tower[:2] + distance * np.array([math.cos(angle), math.sin(angle)])
        beside = np.array([x, y, float(site.truth.elevation_at(x, y)) + MAST])
        view = seen_plume(sight, plume, beside) if np.isfinite(beside).all() else None
        if view is None or crossing_deg(beside, seen[0].tower, at) > _TOGETHER:
            return None
        seen.append(view)
    return seen


def crossing_deg(a: Float64Array, b: Float64Array, at: Float64Array) -> float:
    """Degrees between the directions from a place to two towers, at most 90: lines cross either way."""
    u, v = a[:2] - at, b[:2] - at
    angle = abs(math.degrees(math.atan2(float(u[0] * v[1] - u[1] * v[0]), float(u @ v))))
    return min(angle, 180.0 - angle)


def _score(
    site: str,
    case: Case,
    boxed: bool,
    locator: Locator,
    views: list[SeenPlume],
    marks: list[Sighting],
    wrong: int,
    drawer: Drawer | None,
) -> Trial:
    foot = views[0].plume.foot
    began = time.perf_counter()
    nothing = Trial(
        site,
        case.value,
        boxed,
        float(np.mean([view.range for view in views])),
        min(view.hidden for view in views),
        *(math.nan, math.nan, 1.0, False, False, math.nan, math.nan, 0, True, ""),
        f"camera_{wrong}" if wrong >= 0 else "",
        math.nan,
    )
    try:
        location = locator.locate(marks, smoke=True)
    except RegionError as error:
        return replace(nothing, unlocated=str(error))
    spent = 1000 * (time.perf_counter() - began)
    posterior, x, y = location.posterior, float(foot[0]), float(foot[1])
    if drawer is not None:
        drawer(location, marks, (x, y))
    half, most = posterior.ellipse(0.5), posterior.ellipse(0.95)
    agreement = location.agreement
    return replace(
        nothing,
        error=math.hypot(posterior.mean[0] - x, posterior.mean[1] - y),
        likeliest_error=math.hypot(posterior.likeliest[0] - x, posterior.likeliest[1] - y),
        densest=posterior.credibility(x, y),
        in_50=posterior.holds(half, x, y),
        in_95=posterior.holds(most, x, y),
        major=most.major,
        minor=most.minor,
        modes=len(posterior.modes),
        agreed=agreement is None or agreement.agree,
        named="" if agreement is None or agreement.wrong is None else agreement.wrong,
        milliseconds=spent,
    )
