"""Faults one after the other, and how long the graph takes to be whole again after each; or none, for hours."""

import contextlib
import os
import random
import signal
import time
from collections import Counter
from itertools import pairwise

import numpy as np
from scipy.stats import theilslopes

from chaos.cameras import CAMERAS
from chaos.faults import Arena, Fault, draw_fault
from chaos.running_site import RUNNER
from chaos.stage import PERIOD_S, Stage
from ltm_lab.bench.process_usage import usage_of

BACK_S = 15.0
"""Maximum seconds after a fault until frames of every camera are announced again."""
REPORTS_S = 30.0
"""Maximum seconds until a process that replaced another reports."""
START_S = 60.0
"""The same after a start of the whole graph."""
GAP_S = 5.0
"""Maximum seconds between two announcements of a camera that a fault does not touch, in addition to its period."""
PATIENCE_S = 90.0
"""Seconds after which the run no longer waits for a camera, and kills processes that hang."""
QUIET_S = (1.0, 5.0)
"""Shortest and longest pause between faults in seconds."""
MOST_PSS_KB = 1 << 20
EVERY_S = 5.0
"""Seconds between two samples of a soak."""
A_MINUTE = 12
"""Samples of which the median is taken: processes give back once a minute, by megabytes."""
MOST_KB_A_MINUTE = 10.0
JUDGED_MINUTES = 30.0
"""Minimum duration for a verdict on memory: caches fill during a shorter soak."""


def faults_for(minutes: float, stage: Stage, rng: random.Random, slack: float) -> list[str]:
    """Inject random faults; return what went wrong. `slack`: factor on the allowed times."""
    missed: list[str] = []
    end = time.monotonic() + 60.0 * minutes
    while time.monotonic() < end:
        fault = draw_fault(Arena(stage.site, stage.cameras, stage.disks), rng)
        untouched = [camera for camera in CAMERAS if camera not in fault.touches]
        missed += [f"{fault.name}: {text}" for text in _inject(fault, stage, untouched, slack)]
        time.sleep(rng.uniform(*QUIET_S))
    return missed


def _inject(fault: Fault, stage: Stage, untouched: list[str], slack: float) -> list[str]:
    former, begun = stage.site.processes(), time.monotonic()
    missed = fault.act()
    over = time.monotonic()
    nodes = stage.site.nodes if fault.whole_start else fault.restarts
    bounds = dict.fromkeys(CAMERAS, BACK_S) | dict.fromkeys(nodes, REPORTS_S)
    pss_kb: Counter[str] = Counter()
    back = _wait_back(nodes, former, over, stage, slack, pss_kb)
    missed += [
        f"{name} is back after {seconds:.1f} s"
        for name, seconds in back.items()
        if seconds > slack * (START_S if fault.whole_start else bounds[name])
    ]
    whole = time.monotonic()
    gaps = {camera: _longest_gap(stage, camera, begun, whole) for camera in untouched}
    missed += [
        f"{camera}, which is not touched, paused for {gap:.1f} s"
        for camera, gap in gaps.items()
        if gap > slack * GAP_S + PERIOD_S
    ]
    if not fault.whole_start:
        now = stage.site.processes()
        lasting = former.keys() & {*stage.site.nodes, RUNNER} - {*fault.restarts}
        missed += [f"{label} was ended by it" for label in sorted(lasting) if now.get(label) != former[label]]
    missed += [f"{label} took {kb >> 10} MB" for label, kb in pss_kb.items() if kb > MOST_PSS_KB]
    waited = " ".join(f"{name} {seconds:.1f}" for name, seconds in back.items())
    print(f"{fault.name:<44} s until back: {waited}; {max(pss_kb.values()) >> 10} MB", flush=True)
    for text in missed:
        print(f"  MISSED: {text}", stage.listener.latest, sep="\n", flush=True)
    return missed


def _wait_back(
    nodes: tuple[str, ...], former: dict[str, int], over: float, stage: Stage, slack: float, pss_kb: Counter[str]
) -> dict[str, float]:
    """Return, by name, the seconds until a camera's frame sent after the fault is announced, and until a new process
    reports; infinite if not within `PATIENCE_S`. `pss_kb`: updated with the peak memory of each process."""
    back = dict.fromkeys((*CAMERAS, *nodes), float("inf"))
    while time.monotonic() < over + slack * PATIENCE_S:
        processes = stage.site.processes()
        pss_kb |= Counter({label: one.pss for label, one in usage_of(processes).items()})
        for name in [name for name, at in back.items() if at == float("inf")]:
            if name in CAMERAS:
                back[name] = min((at - over for at in _announced(stage, name, over)), default=float("inf"))
            elif processes.get(name) not in (None, former.get(name)) and stage.listener.reported_since(name, over):
                back[name] = time.monotonic() - over
        if max(back.values()) < float("inf"):
            return back
        time.sleep(0.4)
    for name in nodes:
        pid = stage.site.processes().get(name)
        if pid is not None and pid == former.get(name):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
    return back


def _announced(stage: Stage, camera: str, sent_after: float) -> list[float]:
    """Return the times at which frames of a camera were first announced, in order."""
    announced = stage.listener.announced()
    sent = [frame for frame in stage.cameras.sent_of(camera) if frame.at > sent_after]
    return sorted(announced[frame.stamp_ns][0] for frame in sent if frame.stamp_ns in announced)


def _longest_gap(stage: Stage, camera: str, begun: float, end: float) -> float:
    """Return the longest time between two announcements of a camera, from the last one before `begun` to `end`."""
    times = [at for at in _announced(stage, camera, 0.0) if at <= end]
    moments = [*[at for at in times if at < begun][-1:], *(at for at in times if at >= begun), end]
    return max((later - earlier for earlier, later in pairwise(moments)), default=0.0)


def soak_for(minutes: float, stage: Stage) -> list[str]:
    """No faults: print by how much what each process has asked for (`Usage.own`) grows over the last two thirds, by
    the slope of Theil and Sen, and say whether that is too much in sum."""
    samples: list[dict[str, int]] = []
    begun = time.monotonic()
    while time.monotonic() - begun <= 60.0 * minutes:
        samples.append({label: one.own for label, one in usage_of(stage.site.processes()).items()})
        time.sleep(max(0.0, begun + EVERY_S * len(samples) - time.monotonic()))
    settled = samples[len(samples) // 3 :]
    lasting = sorted(set.intersection(*map(set, settled)))
    size = A_MINUTE if len(settled) >= 2 * A_MINUTE else 1
    series = {label: np.array([sample[label] for sample in settled], float) for label in lasting}
    series["in sum"] = np.sum(list(series.values()), axis=0)
    slope = 0.0
    for label, kb in series.items():
        minutely = np.median(kb[: len(kb) // size * size].reshape(-1, size), axis=1)
        slope, _, low, high = theilslopes(minutely, np.arange(len(minutely)) * size * EVERY_S / 60.0)
        print(f"  {label:<20}{slope:9.1f} kB a minute ({low:.1f} to {high:.1f}); {np.ptp(minutely):.0f} kB apart")
    judged = minutes >= JUDGED_MINUTES and slope > MOST_KB_A_MINUTE
    return [f"memory grows by {slope:.1f} kB a minute in sum"] if judged else []
