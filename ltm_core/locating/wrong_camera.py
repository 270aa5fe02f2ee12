"""Find the turned camera of a site from the marks of several fires.

It is not known when a camera was turned, and its marks from before do not contradict it: each moment between two fires
is tried. Cameras whose mount no longer fits their images (`mount_watch`) are `lost`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.base.utc_time import DAY_NS
from ltm_core.locating.turn_evidence import STEP, TURNS, TurnEvidence

_ONE_PLACE = math.radians(1.0)
"""Angle within which fires that all cameras mark are at one place."""
_SLIP_MEDIAN = math.radians(1.5)
_SLIP_SPREAD = 0.8
"""Logarithmic standard deviation of the size of a slip, which is lognormal: 85 % of slips are between 0.5 and 5
degrees, 2 % above 8. These are assumptions; we know of no record of slips."""
_LOST = math.log(100.0)
"""Logarithm of the factor by which a camera reported as lost is more likely to be turned, before or after its last
fire. On rendered frames, the mount monitor reported 18 of 20 turned cameras, and none in 544 images of others."""
_SHORTEST_NS = 10_000_000_000
"""Minimum age of a turn; it is log-uniform from this to a day before the first fire, because the rate of slips is
unknown."""


@dataclass(frozen=True)
class TurnVerdict:
    """Which camera is turned.

    `suspicion`: probability by camera. `suspect`: the most probable camera. `wrong`: the suspect if it is sure enough.
    `turn`, `sigma`: radians by which the suspect's stated azimuths are too great, if it is turned. `fires`: number of
    fires that the suspect has marked. `by`: the evidence that names `wrong`: `marks`, `pictures` or both.
    """

    suspicion: dict[str, float]
    suspect: str | None
    wrong: str | None
    turn: float
    sigma: float
    fires: int
    by: tuple[str, ...] = ()


def slip_density(turn: Float64Array, step: float) -> Float64Array:
    """Return the density per radian of the angle (radians) by which a mount has slipped, to either side. `step`:
    difference between two angles; turns of less than half of it are not distinguished."""
    size = np.maximum(np.abs(turn), step / 2)
    bell = np.exp(-0.5 * (np.log(size / _SLIP_MEDIAN) / _SLIP_SPREAD) ** 2)
    return np.asarray(bell / (2 * size * _SLIP_SPREAD * math.sqrt(2 * math.pi)), np.float64)


SLIPS = slip_density(TURNS, STEP)
NONE_TURNED = TurnVerdict({}, None, None, 0.0, 0.0, 0)


def judged(
    fires: Sequence[TurnEvidence],
    sure: float,
    slips: Float64Array = SLIPS,
    stamps: Sequence[int] | None = None,
    lost: Collection[str] = (),
) -> TurnVerdict:
    """Return whether a camera is turned, and which.

    "One camera is turned" and "none is" are equally probable beforehand, and so are the cameras. If none is turned,
    poses still err within their covariances, by the same angle at all fires: the best such explanation by one camera
    counts.

    `fires`: evidence of different fires. `sure`: probability above which a camera is named; if two cameras mark a
    single fire, marks name neither. `slips`: (T,) density of the angle of a turn. `stamps`: times of the fires,
    nanoseconds; None: all at one time. `lost`: cameras whose pose is no longer known, by their own images.
    """
    marking = list(dict.fromkeys(name for fire in fires for name in fire.ratios))
    names = [*marking, *sorted(set(lost) - set(marking))]
    if not names:
        return NONE_TURNED
    at = [0] * len(fires) if stamps is None else stamps
    marks = {}
    for name in names:
        marked = [(t, fire.ratios[name]) for t, fire in zip(at, fires, strict=True) if name in fire.ratios]
        always, some_time = _turned_ratios(marked)
        # A lost camera may have been turned after the last fire: its marks then say nothing about the turn.
        marks[name] = always, np.logaddexp(some_time, 0.0) if name in lost else some_time
    sigmas = {name: max((fire.sigmas[name] for fire in fires if name in fire.sigmas), default=0.0) for name in names}
    turned = np.array([_integral(marks[name][1], slips) for name in names])
    none = max(0.0, *(_integral(marks[name][0], _normal(sigmas[name])) for name in names))
    shares = turned - math.log(len(marking) or len(names)) + [_LOST if name in lost else 0.0 for name in names]
    every = float(np.logaddexp.reduce([*shares, none]))
    suspicion = {name: math.exp(share - every) for name, share in zip(names, shares.tolist(), strict=True)}
    suspect = max(names, key=lambda name: suspicion[name])
    weights = np.exp(marks[suspect][1] - marks[suspect][1].max()) * slips
    weights /= weights.sum()
    turn = float(weights @ TURNS)
    sigma = math.sqrt(float(weights @ (TURNS - turn) ** 2) + STEP**2 / 12)
    seen = sum(suspect in fire.ratios for fire in fires)
    unsure = suspicion[suspect] <= sure or (suspect not in lost and len(marking) <= 2 and seen == 1)
    if unsure:
        return TurnVerdict(suspicion, suspect, None, turn, sigma, seen)
    by = ["pictures"] if suspect in lost else ["marks"]
    if suspect in lost and judged(fires, sure, slips, stamps).wrong == suspect:
        by.insert(0, "marks")
    return TurnVerdict(suspicion, suspect, suspect, turn, sigma, seen, tuple(by))


@dataclass
class FireMemory:
    """Evidence of a site's recent fires, newest last, and the lost cameras. Fires at one place count as one, because an
    error of the terrain model makes the same camera suspect there again and again.

    `sure`: see `judged`. `memory_ns`: age at which a fire is forgotten. `most`: maximum number of fires.
    """

    sure: float
    memory_ns: int = DAY_NS
    most: int = 32
    lost: set[str] = field(default_factory=set)
    _fires: dict[int, tuple[int, TurnEvidence]] = field(default_factory=dict)

    def note(self, fire: int, stamp_ns: int, evidence: TurnEvidence) -> None:
        """Replace the evidence of the same fire, or of one at its place, unless that came from more cameras."""
        kept = stamp_ns, evidence
        for key in [key for key, (_, known) in self._fires.items() if key == fire or _of_one_place(known, evidence)]:
            before = self._fires.pop(key)
            kept = before if len(before[1].ratios) > len(kept[1].ratios) else kept
        self._fires[fire] = kept
        self._fires = dict(list(self._fires.items())[-self.most :])
        self.expire(stamp_ns)

    def forget(self, camera: str) -> bool:
        """Forget the fires that a camera whose pose was corrected has marked; return whether there were any."""
        before = len(self._fires)
        self._fires = {key: fire for key, fire in self._fires.items() if camera not in fire[1].ratios}
        return len(self._fires) < before

    def expire(self, now_ns: int) -> None:
        """Forget fires that are older than `memory_ns`."""
        self._fires = {key: fire for key, fire in self._fires.items() if now_ns - fire[0] <= self.memory_ns}

    @property
    def verdict(self) -> TurnVerdict:
        fires = [evidence for _, evidence in self._fires.values()]
        return judged(fires, self.sure, stamps=[stamp for stamp, _ in self._fires.values()], lost=self.lost)


def _of_one_place(one: TurnEvidence, other: TurnEvidence) -> bool:
    shared = one.azimuths.keys() & other.azimuths.keys()
    off = [math.remainder(one.azimuths[name] - other.azimuths[name], 2 * math.pi) for name in shared]
    return len(off) > 1 and max(map(abs, off)) < _ONE_PLACE


def _turned_ratios(fires: Sequence[tuple[int, Float64Array]]) -> tuple[Float64Array, Float64Array]:
    """Return two (T,) log likelihood ratios of one camera's marks, turned to not turned: since before all fires, and
    since an unknown time. `fires`: stamp and (T,) ratio of each (`TurnEvidence.ratios`)."""
    stamps = sorted({stamp for stamp, _ in fires})
    if not stamps:
        return np.zeros(len(TURNS)), np.zeros(len(TURNS))
    since = np.array([np.sum([ratio for stamp, ratio in fires if stamp >= begin], axis=0) for begin in stamps])
    ages = (stamps[-1] - np.array(stamps, np.float64)) + _SHORTEST_NS
    older = np.concatenate([[ages[0] + DAY_NS], ages[:-1]])
    chances = np.log(np.log(older / ages)) - math.log(math.log((ages[0] + DAY_NS) / _SHORTEST_NS))
    whole = np.logaddexp.reduce(since + chances[:, None], axis=0)
    return np.asarray(since[0], np.float64), np.asarray(whole, np.float64)


def _integral(logs: Float64Array, density: Float64Array) -> float:
    """Return the logarithm of the mean of a likelihood over a density of turns."""
    greatest = float(logs.max())
    if not math.isfinite(greatest):
        return -math.inf
    return greatest + math.log(float(np.exp(logs - greatest) @ density) / float(density.sum()))


def _normal(sigma: float) -> Float64Array:
    wide = max(sigma, STEP / 2)
    return np.asarray(np.exp(-0.5 * (TURNS / wide) ** 2), np.float64)
