"""Runs smoke trials on a site and scores the places that are found: error, coverage, disagreement."""

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from ltm_core.base.errors import RegionError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.geodesy import ray_bend
from ltm_core.locating.locator import Locator
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sighting import Sighting
from ltm_core.raster.dem import Dem
from ltm_core.visibility.point_visibility import PointVisibility
from ltm_lab.evaluation.locating.control_points import PlaceScore
from ltm_lab.evaluation.locating.smoke_sites import MAST, SmokeSite, ranged_mountains, smoke_site
from ltm_lab.evaluation.locating.smoke_trials import PoseErrors, SeenPlume, random_plume, seen_plume, sighting
from ltm_lab.frames.truth_frames_io import open_dem, read_truth_frames

NEAREST, FARTHEST = 800.0, 10_000.0
"""Metres from a tower to smoke."""
_WIDE, _APART, _TOGETHER = 30.0, 15.0, 5.0
"""Degrees at the foot: two cameras that cross well, three that are told apart, two from one direction."""
TURNED_DEG = 2.0
"""Degrees by which a camera is turned without notice."""
_BESIDE = 60.0, 160.0
"""Metres between two towers that look from one direction."""


class Case(StrEnum):
    ONE = "one camera"
    TWO = "two cameras, 30 deg and more apart"
    SAME = "two cameras from one direction"
    THREE = "three cameras"
    TURNED = "three cameras, one turned by 2 deg"


@dataclass(frozen=True)
class SmokeJob:
    """Smoke trials on one site: a raster, a folder of `ltm-lab simulate` with its cameras, or (None) mountains drawn by
    the seed. `dem_error`: sigma of the heights in metres, None for a tenth of a cell. `boxed`: a box is marked, or a
    pixel is clicked on."""

    place: Path | None
    seed: int
    cases: tuple[Case, ...]
    boxed: tuple[bool, ...]
    count: int
    angle_sigma: float
    dem_error: float | None


@dataclass(frozen=True)
class SmokeTrial:
    """One trial. `range`: mean of the cameras', metres. `hidden`: metres of the plume that the camera that sees it best
    does not see. `agreed`: the cameras were taken to agree. `wrong`: the turned camera. `suspect`: the camera that is
    most probably wrong, if they disagree."""

    site: str
    case: str
    boxed: bool
    range: float
    hidden: float
    wrong: str
    place: PlaceScore
    agreed: bool = True
    suspect: str = ""
    milliseconds: float = math.nan


def run_smoke_job(job: SmokeJob) -> list[SmokeTrial]:
    """Run all cases on a site, with clicks, boxes, or both."""
    name, towers = f"seed {job.seed}", None
    if job.place is None:
        dem = ranged_mountains(job.seed)
    elif job.place.is_dir():
        name, dem = job.place.name, open_dem(job.place)
        towers = np.unique([frame.pose.position for frame in read_truth_frames(job.place)], axis=0)
    else:
        name, dem = f"{job.place.parent.name}/{job.place.stem}", Dem.open(job.place)
    error = 0.1 * dem.geometry.resolution if job.dem_error is None else job.dem_error
    site, config = smoke_site(name, dem, error, job.seed, towers), LocatingConfig(dem_sigma=error)
    return [
        trial
        for boxed in job.boxed
        for trial in smoke_trials(site, job.cases, job.count, PoseErrors(job.angle_sigma), config, boxed, job.seed)
    ]


def smoke_trials(
    site: SmokeSite,
    cases: tuple[Case, ...],
    count: int,
    errors: PoseErrors,
    config: LocatingConfig,
    boxed: bool,
    seed: int,
) -> Iterator[SmokeTrial]:
    """Yield `count` trials of each case on a site."""
    bend = ray_bend(True, 0.13)
    sight = PointVisibility(site.truth, True)
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
                yield _scored(site.name, case, boxed, locator, views, found, f"camera_{wrong}" if wrong >= 0 else "")


def views_of_case(
    rng: np.random.Generator, site: SmokeSite, sight: PointVisibility, case: Case
) -> list[SeenPlume] | None:
    """Return smoke at a random place as the towers of a case see it; None if they do not."""
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
    apart = _WIDE if case is Case.TWO else _APART
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
    """Return the degrees between the directions from a place to two towers, at most 90: lines cross either way."""
    u, v = a[:2] - at, b[:2] - at
    angle = abs(math.degrees(math.atan2(float(u[0] * v[1] - u[1] * v[0]), float(u @ v))))
    return min(angle, 180.0 - angle)


def _scored(
    site: str,
    case: Case,
    boxed: bool,
    locator: Locator,
    views: Sequence[SeenPlume],
    marks: Sequence[Sighting],
    wrong: str,
) -> SmokeTrial:
    away, hidden = float(np.mean([view.range for view in views])), min(view.hidden for view in views)
    x, y = (float(v) for v in views[0].plume.foot[:2])
    began = time.perf_counter()
    try:
        location = locator.locate(marks, smoke=True)
    except RegionError as error:
        return SmokeTrial(site, case.value, boxed, away, hidden, wrong, PlaceScore(unlocated=str(error)))
    spent = 1000 * (time.perf_counter() - began)
    agreement = location.agreement
    return SmokeTrial(
        site, case.value, boxed, away, hidden, wrong, PlaceScore.of(location.posterior, x, y),
        agreement is None or agreement.agree,
        "" if agreement is None or agreement.agree else max(agreement.suspicion, key=agreement.suspicion.__getitem__),
        spent,
    )  # fmt: skip


@dataclass(frozen=True)
class SmokeSummary:
    """Smoke trials of one kind. Shares are of all trials, those without an answer count as misses; errors are medians
    of those with one, and `error_p90` the 90th percentile. `suspected`: share of the turned cameras that were the most
    suspicious one. NaN of none."""

    count: int
    unlocated: int
    range_km: float
    error: float
    error_share: float
    error_p90: float
    likeliest_error: float
    likeliest_share: float
    ellipse_50: float
    ellipse_95: float
    densest_50: float
    densest_95: float
    major: float
    minor: float
    agreed: float
    suspected: float
    milliseconds: float

    @classmethod
    def of(cls, trials: Sequence[SmokeTrial]) -> "SmokeSummary":
        found = [trial for trial in trials if not trial.place.unlocated]

        def middle(values: Sequence[float], at: float = 50.0) -> float:
            return float(np.percentile(values, at)) if values else math.nan

        def share(values: Sequence[bool]) -> float:
            return float(np.mean(values)) if values else math.nan

        return cls(
            len(trials),
            len(trials) - len(found),
            middle([trial.range / 1000 for trial in trials]),
            middle([trial.place.error for trial in found]),
            middle([trial.place.error / trial.range for trial in found]),
            middle([trial.place.error for trial in found], 90.0),
            middle([trial.place.likeliest_error for trial in found]),
            middle([trial.place.likeliest_error / trial.range for trial in found]),
            share([trial.place.in_50 for trial in trials]),
            share([trial.place.in_95 for trial in trials]),
            share([trial.place.densest < 0.5 for trial in trials]),
            share([trial.place.densest < 0.95 for trial in trials]),
            middle([trial.place.major for trial in found]),
            middle([trial.place.minor for trial in found]),
            share([trial.agreed for trial in found]),
            share([trial.suspect == trial.wrong for trial in trials if trial.wrong]),
            middle([trial.milliseconds for trial in found]),
        )
