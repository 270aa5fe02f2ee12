"""Prints what a run has found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from chaos.bounded_caches import STATED, caches_of
from chaos.cameras import CAMERAS
from chaos.chaos_run import Outcome
from chaos.soak import Growth
from chaos.verdict import Verdict


def heading() -> str:
    cameras = "".join(f"{camera:>8}" for camera in CAMERAS)
    times = f"{'lasted':>7}{cameras}{'node':>8}{'waited':>8}{'pause':>8}"
    return f"{'at s':>6}  {'fault':<44}{times}{'load':>6}{'PSS MB':>8}  of"


def line(outcome: Outcome) -> str:
    """A row: seconds until each camera's frames were acknowledged again, until the node reported again, how much of
    that it waited for a core, the longest pause of a camera that was not touched, and the largest process."""
    back = "".join(_seconds(outcome.cameras.get(camera)) for camera in CAMERAS)
    node = _seconds(max(outcome.nodes.values(), key=lambda s: s or 1e9)) if outcome.nodes else _nothing()
    waited = _seconds(outcome.waited) if outcome.nodes else _nothing()
    pause = _seconds(max(outcome.gaps.values())) if outcome.gaps else _nothing()
    row = (
        f"{outcome.begun:6.0f}  {outcome.fault:<44}{outcome.lasted:7.1f}{back}{node}{waited}{pause}{outcome.load:6.1f}"
    )
    largest = max(outcome.pss_kb, key=lambda label: outcome.pss_kb[label], default="")
    row += f"{outcome.pss_kb.get(largest, 0) >> 10:8d}  {largest}"
    return "\n".join([row, *(f"        MISSED: {text}" for text in outcome.missed)])


def counts(verdict: Verdict) -> str:
    return (
        f"{verdict.sent} frames sent, {verdict.stored} in the store, {verdict.told} told of; told of and "
        f"lost {len(verdict.lost)}, told of twice {len(verdict.told_twice)}, in the store and not told of "
        f"{len(verdict.untold)}"
    )


def causes(counted: Mapping[str, int], most: int = 40) -> Iterable[str]:
    """What nodes dropped and noted, the commonest first."""
    for name, count in sorted(counted.items(), key=lambda item: -item[1])[:most]:
        yield f"  {count:6d}  {name}"


def growth(own: Mapping[str, Growth]) -> Iterable[str]:
    """Of memory, by process. Below each, what it keeps that is bounded."""
    yield "own memory over the last two thirds: kB a minute (95 % interval); kB grown, the largest step of it"
    for label, one in own.items():
        row = f"  {label:<20}{_slope(one)}; {one.grown:.0f}, {one.largest_step:.0f}"
        yield row
        yield from (f"    keeps {said}" for said in caches_of(label))
    yield f"  nothing is subtracted for what is kept; bounds: {STATED}"


def _slope(growth: Growth) -> str:
    return f"{growth.slope:9.1f}  ({growth.low:.1f} to {growth.high:.1f})"


def _seconds(value: float | None) -> str:
    return f"{'never':>8}" if value is None else f"{value:8.1f}"


def _nothing() -> str:
    return f"{'-':>8}"
