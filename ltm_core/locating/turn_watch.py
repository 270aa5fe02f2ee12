"""Which camera of a site is turned, by the marks of several fires and by its own pictures together."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.base.utc_time import DAY_NS
from ltm_core.locating.picture_memory import remembered
from ltm_core.locating.slip_history import turned_ratios
from ltm_core.locating.slips import LOST, slip_density
from ltm_core.locating.turn_evidence import STEP, TURNS, TurnEvidence
from ltm_core.pose_estimation.mount.skyline_turns import SkylineTurns

_ONE_PLACE = math.radians(1.0)
"""Within which the marks of all cameras are of one place."""


MOST_PICTURES = 12
"""Of a camera that count, the newest: for a head, its last few presets. As many older ones are remembered besides."""


@dataclass(frozen=True)
class TurnVerdict:
    """`suspicion`: by camera, the probability that it is turned; `suspect`: the greatest's. `wrong`: the suspect, where
    that is sure. `turn`, `sigma`: radians by which the suspect's stated azimuths are too great, if it is turned.
    `fires`, `pictures`: of how many of the suspect it was judged by. `by`: what names it, `marks`, `pictures`, or both.
    """

    suspicion: dict[str, float]
    suspect: str | None
    wrong: str | None
    turn: float
    sigma: float
    fires: int
    pictures: int = 0
    by: tuple[str, ...] = ()


SLIPS = slip_density(TURNS, STEP)
NOBODY = TurnVerdict({}, None, None, 0.0, 0.0, 0)
_NONE_SEEN: Mapping[str, Sequence[SkylineTurns]] = {}


def judged(
    fires: Sequence[TurnEvidence],
    sure: float,
    slips: Float64Array = SLIPS,
    pictures: Mapping[str, Sequence[SkylineTurns]] = _NONE_SEEN,
    stamps: Sequence[int] | None = None,
    lost: Collection[str] = (),
) -> TurnVerdict:
    """Whether one camera is turned, and which.

    That one is turned is as probable beforehand as that none is, and each camera as another; by how much is known as
    `slip_density` has it, and since when as `slip_history` has it. Where none is, the poses still err by what their
    covariances say, and alike in all fires: of this the explanation by the one camera that makes the marks likeliest
    stands for all, so that none is named for an error that its covariance allows.

    Args:
        fires: of different fires; several sightings of one fire are one.
        sure: probability above which a camera is named; of two that mark one fire none is, unless by its pictures: it
            may be two fires.
        slips: (T,) density of the angle of a camera that is turned.
        pictures: by camera, what the skylines of its latest clear pictures say.
        stamps: of the fires; None: all of one time.
        lost: cameras that look elsewhere, as their nodes `pose` say after several pictures.
    """
    marking = list(dict.fromkeys(name for fire in fires for name in fire.ratios))
    names = [*marking, *(name for name, seen in pictures.items() if seen and name not in marking)]
    if not names:
        return NOBODY
    at = [0] * len(fires) if stamps is None else stamps
    told = {
        name: turned_ratios(
            [(stamp, fire.ratios[name]) for stamp, fire in zip(at, fires, strict=True) if name in fire.ratios],
            pictures.get(name, ()),
        )
        for name in names
    }
    sigmas = {name: max((fire.sigmas[name] for fire in fires if name in fire.sigmas), default=0.0) for name in names}
    turned = np.array([_integral(told[name][1], slips) for name in names])
    none = max(0.0, *(_integral(told[name][0], _normal(sigmas[name])) for name in names))
    shares = turned - math.log(len(marking) or len(names)) + [LOST if name in lost else 0.0 for name in names]
    every = float(np.logaddexp.reduce([*shares, none]))
    suspicion = {name: math.exp(share - every) for name, share in zip(names, shares.tolist(), strict=True)}
    suspect = max(names, key=lambda name: suspicion[name])
    weights = np.exp(told[suspect][1] - told[suspect][1].max()) * slips
    weights /= weights.sum()
    turn = float(weights @ TURNS)
    sigma = math.sqrt(float(weights @ (TURNS - turn) ** 2) + STEP**2 / 12)
    seen = sum(suspect in fire.ratios for fire in fires)
    looked = len(pictures.get(suspect, ()))
    wrong = suspect if suspicion[suspect] > sure else None
    if wrong is not None and len(marking) <= 2 and seen == 1:
        wrong = suspect if looked and judged([], sure, slips, pictures, lost=lost).wrong == suspect else None
    by = () if wrong is None else (*(["marks"] if seen else []), *(["pictures"] if looked else []))
    return TurnVerdict(suspicion, suspect, wrong, turn, sigma, seen, looked, by)


@dataclass
class TurnWatch:
    """What a site's fires say, newest last.

    What the terrain model has wrong at a place makes the same camera suspect there again and again, so fires at one
    place count as one: a chimney that is marked all day long is no more than one fire.

    Args:
        sure: `judged`.
        memory_ns: fires seen longer ago do not count: a mount that has been put right is right again.
        most: fires that count, the newest.
        lost: cameras that look elsewhere, as their nodes `pose` say.
        most_pictures: of a camera, the newest that count (`remembered`).
    """

    sure: float
    memory_ns: int = DAY_NS
    most: int = 32
    most_pictures: int = MOST_PICTURES
    lost: set[str] = field(default_factory=set)
    _fires: dict[int, tuple[int, TurnEvidence]] = field(default_factory=dict)
    _pictures: dict[str, list[SkylineTurns]] = field(default_factory=dict)

    def note(self, fire: int, stamp_ns: int, evidence: TurnEvidence) -> None:
        """Takes the place of what the same fire, or one at its place, has said before, unless that was of more
        cameras.
        """
        said = stamp_ns, evidence
        for key in [key for key, (_, known) in self._fires.items() if key == fire or _of_one_place(known, evidence)]:
            before = self._fires.pop(key)
            said = before if len(before[1].ratios) > len(said[1].ratios) else said
        self._fires[fire] = said
        self._fires = dict(list(self._fires.items())[-self.most :])
        self.expire(stamp_ns)

    def look(self, camera: str, seen: SkylineTurns) -> None:
        """Take what a clear picture of a camera says; give them in time order."""
        self._pictures[camera] = remembered([*self._pictures.get(camera, ()), seen], self.most_pictures)

    def forget(self, camera: str) -> bool:
        """Begin anew with a camera whose poses are others now: of fires that it has marked, what was said of the others
        hung on its direction too. Whether there were any.
        """
        self._pictures.pop(camera, None)
        before = len(self._fires)
        self._fires = {key: fire for key, fire in self._fires.items() if camera not in fire[1].ratios}
        return len(self._fires) < before

    def expire(self, now_ns: int) -> None:
        """Forget what was seen too long ago."""
        self._fires = {key: fire for key, fire in self._fires.items() if now_ns - fire[0] <= self.memory_ns}
        for camera, pictures in self._pictures.items():
            self._pictures[camera] = [seen for seen in pictures if now_ns - seen.stamp_ns <= self.memory_ns]

    @property
    def verdict(self) -> TurnVerdict:
        fires, stamps = [fire for _, fire in self._fires.values()], [stamp for stamp, _ in self._fires.values()]
        both = judged(fires, self.sure, pictures=self._pictures, stamps=stamps, lost=self.lost)
        if both.wrong is None:
            return both
        by = {
            "marks": judged(fires, self.sure, stamps=stamps).wrong,
            "pictures": judged([], self.sure, pictures=self._pictures, lost=self.lost).wrong,
        }
        alone = tuple(what for what, wrong in by.items() if wrong == both.wrong)
        return replace(both, by=alone or tuple(by))


def _of_one_place(one: TurnEvidence, other: TurnEvidence) -> bool:
    shared = one.azimuths.keys() & other.azimuths.keys()
    off = [math.remainder(one.azimuths[name] - other.azimuths[name], 2 * math.pi) for name in shared]
    return len(off) > 1 and max(map(abs, off)) < _ONE_PLACE


def _integral(logs: Float64Array, density: Float64Array) -> float:
    """Logarithm of the mean of a likelihood over a density of turns."""
    greatest = float(logs.max())
    if not math.isfinite(greatest):
        return -math.inf
    return greatest + math.log(float(np.exp(logs - greatest) @ density) / float(density.sum()))


def _normal(sigma: float) -> Float64Array:
    wide = max(sigma, STEP / 2)
    return np.asarray(np.exp(-0.5 * (TURNS / wide) ** 2), np.float64)
