"""Cases of three cameras of which one is turned, or none, that mark several fires at different places: who is named."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ltm_core.base.errors import RegionError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.geodesy import ray_bend
from ltm_core.locating.locator import Locator
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sighting import Sighting
from ltm_core.locating.turn_evidence import STEP, TURNS, TurnEvidence
from ltm_core.locating.turn_watch import SLIPS, TurnVerdict, judged
from ltm_core.visibility.point_visibility import PointVisibility
from ltm_lab.evaluation.locating.smoke_score import (
    APART,
    FARTHEST,
    NEAREST,
    TURNED_DEG,
    Case,
    crossing_deg,
    views_of_case,
)
from ltm_lab.evaluation.locating.smoke_sites import SmokeSite
from ltm_lab.evaluation.locating.smoke_trials import PoseErrors, SeenPlume, random_plume, seen_plume, sighting

EXACTLY = np.where(np.abs(np.abs(TURNS) - math.radians(TURNED_DEG)) < STEP / 2, 1.0, 0.0)
"""Density of slips for one who knows their angle, though not whether there is one."""
_TRIES = 4_000
"""Places that are tried for fires that the same three towers see."""


@dataclass(frozen=True, eq=False)
class TurnedCase:
    """`turned`: the camera that is, "" of none; `turn_deg`: by how much. `fires`: what the marks of each say."""

    site: str
    turned: str
    turn_deg: float
    fires: tuple[TurnEvidence, ...]

    def verdict(self, fires: int, sure: float, slips: Float64Array = SLIPS) -> TurnVerdict:
        """After the first ones."""
        return judged(self.fires[:fires], sure, slips)

    @property
    def told(self) -> bool:
        """Whether one fire's marks are likeliest with the turned camera turned, of one who is told that some camera is
        turned by exactly so much, to either side: no test of these marks by this model is right more often.
        """
        at = [int(np.argmin(np.abs(TURNS - math.radians(turn)))) for turn in (TURNED_DEG, -TURNED_DEG)]
        if not self.fires:
            return False
        ratios = self.fires[0].ratios
        by_name = {name: float(np.logaddexp(*(ratio[k] for k in at))) for name, ratio in ratios.items()}
        return max(by_name, key=lambda name: by_name[name]) == self.turned


@dataclass(frozen=True)
class NamingScore:
    """Shares of cases after a number of fires: the turned camera `named`, a right one `wrongly_named`, the turned one
    the most `suspect`. `off_deg`: median error of the angle, where the turned one is named.
    """

    fires: int
    count: int
    named: float
    wrongly_named: float
    suspect: float
    off_deg: float

    @classmethod
    def of(cls, cases: Sequence[TurnedCase], fires: int, sure: float, slips: Float64Array = SLIPS) -> NamingScore:
        """`slips`: `TurnedCase.verdict`."""
        verdicts = [(case, case.verdict(fires, sure, slips)) for case in cases]
        found = [(case, verdict) for case, verdict in verdicts if case.turned and verdict.wrong == case.turned]
        most = [bool(case.turned) and said.suspect == case.turned for case, said in verdicts]
        off = [abs(math.degrees(verdict.turn) - case.turn_deg) for case, verdict in found]
        wrongly_named = [verdict.wrong is not None and verdict.wrong != case.turned for case, verdict in verdicts]
        return cls(
            fires,
            len(cases),
            len(found) / len(cases),
            float(np.mean(wrongly_named)),
            float(np.mean(most)),
            float(np.median(off)) if off else math.nan,
        )

    def row(self) -> dict[str, Any]:
        """For JSON."""
        return {key: value if value == value else None for key, value in vars(self).items()}


def turned_cases(
    site: SmokeSite,
    count: int,
    fires: int,
    turned: bool,
    errors: PoseErrors,
    config: LocatingConfig,
    seed: int,
    curvature: bool = True,
) -> Iterator[TurnedCase]:
    """Cases on a site. A camera's pose is wrong alike at all fires, as a calibrated mount's is; where it looks is not.
    Fires that the marks are refused of are left out.
    """
    bend = ray_bend(curvature, 0.13)
    sight = PointVisibility(site.truth, curvature)
    locator = Locator(site.model, bend, config)
    rng = np.random.default_rng([seed, 7, int(turned)])
    done = 0
    for _ in range(count * 400):
        if done == count:
            break
        first = views_of_case(rng, site, sight, Case.TURNED)
        if first is None:
            continue
        offsets = rng.standard_normal((len(first), 6))
        wrong = int(rng.integers(len(first)))
        turns = np.zeros(len(first))
        turns[wrong] = TURNED_DEG * (1 if rng.uniform() < 0.5 else -1) if turned else 0.0
        marked: list[list[Sighting]] = []
        towers = [view.tower for view in first]
        views: list[SeenPlume] | None = first
        for _ in range(_TRIES):
            if views is not None:
                marks = [
                    sighting(rng, f"camera_{k}", view, bend, errors, config, False, turns[k], offsets[k])
                    for k, view in enumerate(views)
                ]
                found = [mark for mark in marks if mark is not None]
                if len(found) == len(views):
                    marked.append(found)
            if len(marked) == fires:
                break
            views = seen_by_all(rng, site, sight, towers)
        if len(marked) < fires:
            continue
        done += 1
        said = [evidence for marks in marked if (evidence := marks_evidence(locator, marks)) is not None]
        yield TurnedCase(site.name, f"camera_{wrong}" if turned else "", float(turns[wrong]), tuple(said))


def seen_by_all(
    rng: np.random.Generator, site: SmokeSite, sight: PointVisibility, towers: Sequence[Float64Array]
) -> list[SeenPlume] | None:
    """Smoke at a random place around the towers; None where one of them does not see it, or two look alike."""
    at = np.mean([tower[:2] for tower in towers], axis=0) + rng.uniform(-FARTHEST, FARTHEST, 2)
    ground = float(site.truth.elevation_at(*at))
    if math.isnan(ground) or any(not NEAREST < math.hypot(*(tower[:2] - at)) < FARTHEST for tower in towers):
        return None
    pairs = [(a, b) for k, a in enumerate(towers) for b in towers[:k]]
    if any(crossing_deg(a, b, at) < APART for a, b in pairs):
        return None
    plume = random_plume(rng, np.array([*at, ground]))
    views = [view for tower in towers if (view := seen_plume(sight, plume, tower)) is not None]
    return views if len(views) == len(towers) else None


def marks_evidence(locator: Locator, marks: Sequence[Sighting]) -> TurnEvidence | None:
    try:
        agreement = locator.locate(marks, smoke=True).agreement
    except RegionError:
        return None
    return None if agreement is None else agreement.turns
