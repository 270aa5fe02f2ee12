"""Which camera of a site is turned, by the marks of several fires together."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from ltm_core.locating.slips import HELD, slip_density
from ltm_core.locating.turn_evidence import STEP, TURNS, TurnEvidence
from ltm_core.types import Float64Array
from ltm_core.utc_time import DAY_NS

_ONE_PLACE = math.radians(1.0)
"""Within which the marks of all cameras are of one place."""


@dataclass(frozen=True)
class TurnVerdict:
    """`suspicion`: by camera, the probability that it is turned; `suspect`: the greatest's. `wrong`: the suspect, where
    that is sure. `turn`, `sigma`: radians by which the suspect's stated azimuths are too great, if it is turned.
    `fires`: by which it was judged.
    """

    suspicion: dict[str, float]
    suspect: str | None
    wrong: str | None
    turn: float
    sigma: float
    fires: int


SLIPS = slip_density(TURNS, STEP)
NOBODY = TurnVerdict({}, None, None, 0.0, 0.0, 0)


def judged(
    fires: Sequence[TurnEvidence], sure: float, held: Collection[str] = (), slips: Float64Array = SLIPS
) -> TurnVerdict:
    """Whether one camera is turned, and which.

    That one is turned is as probable beforehand as that none is, and each camera as another, but for those that are
    `held`; by how much is known as `slip_density` has it. Where none is, the poses still err by what their covariances
    say, and alike in all fires: of this the explanation by the one camera that makes the marks likeliest stands for
    all, so that none is named for an error that its covariance allows.

    Args:
        fires: of different fires; several sightings of one fire are one.
        sure: probability above which a camera is named; of two that mark one fire none is: it may be two fires.
        held: cameras whose pictures say that their poses are right.
        slips: (T,) density of the angle of a camera that is turned.
    """
    names = list(dict.fromkeys(name for fire in fires for name in fire.ratios))
    if not names:
        return NOBODY
    totals = {name: _total(fires, name) for name in names}
    sigmas = {name: max(fire.sigmas[name] for fire in fires if name in fire.sigmas) for name in names}
    turned = np.array([_integral(totals[name], slips) for name in names])
    stated = [_integral(totals[name], _normal(sigmas[name])) for name in names]
    none = max(0.0, *stated)
    chances = np.array([HELD if name in held else 1.0 for name in names]) / len(names)
    shares = turned + np.log(chances)
    every = float(np.logaddexp.reduce([*shares, none]))
    suspicion = {name: math.exp(share - every) for name, share in zip(names, shares.tolist(), strict=True)}
    suspect = max(names, key=lambda name: suspicion[name])
    weights = np.exp(totals[suspect] - totals[suspect].max()) * slips
    weights /= weights.sum()
    turn = float(weights @ TURNS)
    sigma = math.sqrt(float(weights @ (TURNS - turn) ** 2) + STEP**2 / 12)
    seen = sum(suspect in fire.ratios for fire in fires)
    sure_of_it = suspicion[suspect] > sure and (len(names) > 2 or seen > 1)
    return TurnVerdict(suspicion, suspect, suspect if sure_of_it else None, turn, sigma, seen)


@dataclass
class TurnWatch:
    """What a site's fires say, newest last.

    What the terrain model has wrong at a place makes the same camera suspect there again and again, so fires at one
    place count as one: a chimney that is marked all day long is no more than one fire.

    Args:
        sure: `judged`.
        memory_ns: fires seen longer ago do not count: a mount that has been put right is right again.
        most: fires that count, the newest.
        held: cameras whose pictures say that their poses are right.
    """

    sure: float
    memory_ns: int = DAY_NS
    most: int = 32
    held: set[str] = field(default_factory=set)
    _fires: dict[int, tuple[int, TurnEvidence]] = field(default_factory=dict)

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

    def forget(self, camera: str) -> bool:
        """Begin anew with a camera whose poses are others now: of fires that it has marked, what was said of the others
        hung on its direction too. Whether there were any.
        """
        before = len(self._fires)
        self._fires = {key: fire for key, fire in self._fires.items() if camera not in fire[1].ratios}
        return len(self._fires) < before

    def expire(self, now_ns: int) -> None:
        """Forget what was seen too long ago."""
        self._fires = {key: fire for key, fire in self._fires.items() if now_ns - fire[0] <= self.memory_ns}

    @property
    def verdict(self) -> TurnVerdict:
        return judged([evidence for _, evidence in self._fires.values()], self.sure, self.held)


def _of_one_place(one: TurnEvidence, other: TurnEvidence) -> bool:
    shared = one.azimuths.keys() & other.azimuths.keys()
    off = [math.remainder(one.azimuths[name] - other.azimuths[name], 2 * math.pi) for name in shared]
    return len(off) > 1 and max(map(abs, off)) < _ONE_PLACE


def _total(fires: Sequence[TurnEvidence], name: str) -> Float64Array:
    """(T,) of all fires that the camera has seen."""
    ratios = [fire.ratios[name] for fire in fires if name in fire.ratios]
    return np.asarray(np.sum(ratios, axis=0), np.float64)


def _integral(logs: Float64Array, density: Float64Array) -> float:
    """Logarithm of the mean of a likelihood over a density of turns."""
    greatest = float(logs.max())
    if not math.isfinite(greatest):
        return -math.inf
    return greatest + math.log(float(np.exp(logs - greatest) @ density) / float(density.sum()))


def _normal(sigma: float) -> Float64Array:
    wide = max(sigma, STEP / 2)
    return np.asarray(np.exp(-0.5 * (TURNS / wide) ** 2), np.float64)
