"""Cases of three watched eyes, one of them turned or none, that mark a fire: named by marks, by pictures, by both."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ltm_core.locating.locator import Locator
from ltm_core.locating.picture_memory import remembered
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sight_likelihood import LEVEL_SHARE
from ltm_core.locating.turn_evidence import TurnEvidence
from ltm_core.locating.turn_watch import MOST_PICTURES, TurnVerdict, judged
from ltm_core.pose_estimation.mount.skyline_turns import SkylineTurns
from ltm_core.raster.dem import Dem
from ltm_core.raster.dem_stack import DemStack
from ltm_core.visibility.point_visibility import PointVisibility
from ltm_lab.evaluation.locating.smoke_score import TURNED_DEG
from ltm_lab.evaluation.locating.smoke_sites import SmokeSite
from ltm_lab.evaluation.locating.smoke_trials import PoseErrors, sighting
from ltm_lab.evaluation.locating.turned_trials import marks_evidence, seen_by_all
from ltm_lab.evaluation.locating.watched_eyes import EVERY_NS, SECOND_NS, WatchedEye

_CORRELATION = 2.0
"""Cells, of the model's error, as in `smoke_sites`."""
_LEAST_CLEARANCE = 1.0
"""Metres of an eye above the ground as it is taken to be."""
_TO_MARK = 5.0
"""Seconds from the last picture to the marks."""
_TRIES = 4_000
"""Draws of three eyes and a place, for each case that is asked for."""


@dataclass(frozen=True)
class WatchedScore:
    """Shares of cases, `after` so many pictures since the turn: the turned camera named by `marks` alone, by `pictures`
    alone, and by `both`; a right one named, by each.
    """

    after: int
    count: int
    marks: float
    pictures: float
    both: float
    right_marks: float
    right_pictures: float
    right_both: float

    @classmethod
    def of(cls, cases: Sequence[WatchedCase], after: int, sure: float, gap: float) -> WatchedScore:
        """`gap`: `WatchedCase.pictures`."""
        named = [
            (
                case.turned,
                case.marks(sure).wrong,
                case.pictures(sure, after, gap).wrong,
                case.both(sure, after, gap).wrong,
            )
            for case in cases
        ]
        found = [float(np.mean([bool(one[0]) and one[k] == one[0] for one in named])) for k in (1, 2, 3)]
        right = [float(np.mean([one[k] is not None and one[k] != one[0] for one in named])) for k in (1, 2, 3)]
        return cls(after, len(cases), *found, *right)


@dataclass(frozen=True, eq=False)
class WatchedCase:
    """`turned`: the camera that is, "" of none. `fire`: what the marks say; None where they are refused. `eyes`: by
    name; `sides`: by which of `SIDES` each is turned.
    """

    site: str
    turned: str
    fire: TurnEvidence | None
    eyes: dict[str, WatchedEye]
    sides: dict[str, int]

    def marks(self, sure: float) -> TurnVerdict:
        return judged(self._fires, sure)

    def pictures(self, sure: float, after: int, gap: float) -> TurnVerdict:
        """`after`: pictures since the turn; `gap`: seconds between the last one before it and what follows."""
        return judged([], sure, pictures=self._turns(after, gap), lost=self.lost(after))

    def both(self, sure: float, after: int, gap: float) -> TurnVerdict:
        """As `pictures`, with a fire that is marked at last. What a camera marks that is known to look elsewhere says
        nothing any more.
        """
        lost, turns = self.lost(after), self._turns(after, gap)
        fires = [] if lost else self._fires
        newest = max((seen.stamp_ns for each in turns.values() for seen in each), default=0)
        at = newest + round((_TO_MARK if after else gap) * SECOND_NS)
        return judged(fires, sure, pictures=turns, stamps=[at] * len(fires), lost=lost)

    @property
    def _fires(self) -> list[TurnEvidence]:
        return [] if self.fire is None else [self.fire]

    def _turns(self, after: int, gap: float) -> dict[str, list[SkylineTurns]]:
        """Of the pictures those that the node `locate` remembers."""
        said: dict[str, list[SkylineTurns]] = {}
        for name, eye in self.eyes.items():
            before, every = len(eye.shown[self.sides[name], 0].turns), eye.shown[self.sides[name], after].turns
            later = round(gap * SECOND_NS) - EVERY_NS
            since = [replace(seen, stamp_ns=seen.stamp_ns + later) for seen in every[before:]]
            said[name] = []
            for seen in [*every[:before], *since]:
                said[name] = remembered([*said[name], seen], MOST_PICTURES)
        return said

    def lost(self, after: int) -> list[str]:
        return [name for name, eye in self.eyes.items() if eye.shown[self.sides[name], after].noticed]


def eyes_site(name: str, model: Dem, eyes: Sequence[WatchedEye], dem_sigma: float, seed: int) -> SmokeSite:
    """The ground of rendered frames, which counts as its model, the truth being it and correlated errors of each raster
    as locating takes them to be; with those eyes as towers that stand above both.
    """
    rng = np.random.default_rng([seed, 1])
    levels = []
    for level in model.levels:
        noise = ndimage.gaussian_filter(rng.standard_normal(level.elevation.shape, np.float32), _CORRELATION)
        error = max(dem_sigma, LEVEL_SHARE * level.geometry.resolution)
        levels.append(Dem(level.elevation + noise * np.float32(error / noise.std()), level.geometry))
    truth = DemStack.of_fitted(levels) if len(levels) > 1 else levels[0]
    above = [
        eye.position
        for eye in eyes
        if all(
            eye.position[2] - float(dem.elevation_at(*eye.position[:2])) > _LEAST_CLEARANCE for dem in (truth, model)
        )
    ]
    return SmokeSite(name, truth, model, np.array(above).reshape(-1, 3))


def watched_cases(
    site: SmokeSite,
    eyes: Sequence[WatchedEye],
    count: int,
    turned: bool,
    errors: PoseErrors,
    config: LocatingConfig,
    bend: float,
    seed: int,
) -> Iterator[WatchedCase]:
    """Up to `count` cases of three eyes of a site that see the same smoke."""
    sight, locator = PointVisibility(site.truth, bend > 0), Locator(site.model, bend, config)
    rng = np.random.default_rng([seed, 11, int(turned)])
    usable = [eye for eye in eyes if any(np.array_equal(eye.position, tower) for tower in site.towers)]
    done = 0
    for _ in range(count * _TRIES):
        if done == count or len(usable) < 3:
            break
        chosen = [usable[k] for k in rng.permutation(len(usable))[:3]]
        views = seen_by_all(rng, site, sight, [eye.position for eye in chosen])
        if views is None:
            continue
        wrong, side = int(rng.integers(3)), 1 if rng.uniform() < 0.5 else -1
        sides = {eye.name: side if turned and k == wrong else 0 for k, eye in enumerate(chosen)}
        marks = []
        for eye, view in zip(chosen, views, strict=True):
            turn = TURNED_DEG * sides[eye.name]
            mark = sighting(rng, eye.name, view, bend, errors, config, False, turn, eye.offsets)
            if mark is not None:
                pose, covariance = eye.correction.applied(mark.pose, mark.covariance)
                marks.append(replace(mark, pose=pose, covariance=covariance))
        if len(marks) < 3:
            continue
        done += 1
        name = chosen[wrong].name if turned else ""
        yield WatchedCase(site.name, name, marks_evidence(locator, marks), {eye.name: eye for eye in chosen}, sides)
