"""Faults one after the other, and how long the graph takes to be whole again after each."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

from chaos.acknowledgements import Acknowledgements
from chaos.cameras import CAMERAS
from chaos.faults import Arena, Fault, draw_fault
from chaos.heartbeats import Heartbeats
from chaos.resources import waited_s
from chaos.running_site import RUNNER
from ltm_lab.bench.process_usage import usage_of

BACK_S = 15.0
"""In which every camera's frames are acknowledged again after a fault is over."""
REPORTS_S = 30.0
"""In which a process that took the place of another reports: those that no acknowledgement waits for, too."""
START_S = 60.0
"""The same after the whole graph was started anew."""
GAP_S = 5.0
"""Longest time without an acknowledgement of a camera that a fault does not touch, beyond its period."""
PATIENCE_S = 90.0
"""After which a camera is given up and what hangs is ended, so that the run can go on."""
QUIET_S = (1.0, 5.0)
"""Between faults."""
MOST_PSS_KB = 1 << 20
MOST_MORE = {"descriptors": 32, "threads": 16}
"""By which a process may have more of them at its end than when it was first whole."""


@dataclass
class Outcome:
    """What became of one fault. Seconds after its end; None: not within `PATIENCE_S`."""

    fault: str
    begun: float
    lasted: float
    cameras: dict[str, float | None] = field(default_factory=dict)
    nodes: dict[str, float | None] = field(default_factory=dict)
    waited: float = 0.0
    """Of that, seconds for which a new process waited for a core, the longest of them: the machine has other work."""
    gaps: dict[str, float] = field(default_factory=dict)
    """Of cameras that it does not touch: longest time between two acknowledgements."""
    pss_kb: dict[str, int] = field(default_factory=dict)
    """The most that each process held until it was over."""
    load: float = 0.0
    """Processes that wanted a core of this machine over the last minute, on average: what delays may be due to."""
    missed: list[str] = field(default_factory=list)
    reports: dict[str, dict[str, str]] = field(default_factory=dict)
    """What each node reported, when all was over, where something was missed."""


class Sampler:
    """Looks at the memory of all processes every two seconds."""

    def __init__(self, arena: Arena) -> None:
        self._arena = arena
        self._peaks: dict[str, int] = {}
        self._lock = threading.Lock()
        self.sums: list[int] = []
        """kB of PSS of all processes together."""
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="sampler", daemon=True)
        self._thread.start()

    def take_peaks(self) -> dict[str, int]:
        """kB by process since the last call."""
        with self._lock:
            peaks, self._peaks = self._peaks, {}
            return peaks

    def stop(self) -> None:
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stopping.wait(2.0):
            usage = usage_of(self._arena.site.processes())
            with self._lock:
                for label, one in usage.items():
                    self._peaks[label] = max(one.pss, self._peaks.get(label, 0))
            self.sums.append(sum(one.pss for one in usage.values()))


class ChaosRun:
    """Injects faults into a graph that is whole; `outcomes` says what became of each."""

    def __init__(
        self,
        arena: Arena,
        acknowledgements: Acknowledgements,
        heartbeats: Heartbeats,
        kinds: list[str],
        rng: random.Random,
        tell: Callable[[Outcome], None],
        slack: float = 1.0,
    ) -> None:
        """`slack`: by which times may be longer, on a machine that has other work."""
        self.outcomes: list[Outcome] = []
        self._arena, self._acknowledgements, self._heartbeats = arena, acknowledgements, heartbeats
        self._kinds, self._rng, self._tell = kinds, rng, tell
        self._slack = slack
        self._touched: tuple[str, ...] = ()
        """Cameras that the fault before has touched."""
        self._begun = time.monotonic()
        self.sampler = Sampler(arena)

    def run(self, minutes: float) -> None:
        """Faults until the time is over."""
        while time.monotonic() - self._begun < 60.0 * minutes:
            fault = draw_fault(self._kinds, self._arena, self._rng)
            self.outcomes.append(self._inject(fault))
            self._tell(self.outcomes[-1])
            time.sleep(self._rng.uniform(*QUIET_S))
        self.sampler.stop()

    def _inject(self, fault: Fault) -> Outcome:
        former = self._arena.site.processes()
        begun = time.monotonic()
        missed = fault.act()
        over = time.monotonic()
        outcome = Outcome(fault.name, begun - self._begun, over - begun, missed=missed)
        self._wait_back(fault, former, over, outcome)
        whole = time.monotonic()
        bounds = dict.fromkeys(outcome.cameras, BACK_S) | dict.fromkeys(outcome.nodes, REPORTS_S)
        for name, seconds in (outcome.cameras | outcome.nodes).items():
            if seconds is None or seconds > self._slack * (START_S if fault.whole_start else bounds[name]):
                late = "never back" if seconds is None else f"back after {seconds:.1f} s"
                outcome.missed.append(f"{name} {late}")
        touched, self._touched = {*fault.touches, *self._touched}, fault.touches
        for camera in [camera for camera in CAMERAS if camera not in touched]:
            gap = outcome.gaps[camera] = self._longest_gap(camera, begun, whole)
            if gap > self._slack * GAP_S + self._arena.cameras.period_s:
                outcome.missed.append(f"{camera}, which is not touched, paused for {gap:.1f} s")
        if not fault.whole_start:
            now = self._arena.site.processes()
            lasting = former.keys() & {*self._arena.site.nodes, RUNNER} - {*fault.restarts}
            ended = [label for label in sorted(lasting) if now.get(label) != former[label]]
            outcome.missed += [f"{label} was ended by it" for label in ended]
        outcome.load = os.getloadavg()[0]
        outcome.pss_kb = self.sampler.take_peaks()
        outcome.missed += [f"{label} took {kb >> 10} MB" for label, kb in outcome.pss_kb.items() if kb > MOST_PSS_KB]
        outcome.reports = self._heartbeats.said() if outcome.missed else {}
        return outcome

    def _wait_back(self, fault: Fault, former: dict[str, int], over: float, outcome: Outcome) -> None:
        """Until frames sent after the fault are told of, and those that took the place of ended processes report."""
        outcome.cameras = dict.fromkeys(CAMERAS)
        nodes = list(self._arena.site.nodes) if fault.whole_start else list(fault.restarts)
        outcome.nodes = dict.fromkeys(nodes)
        while time.monotonic() < over + self._slack * PATIENCE_S:
            for camera in [camera for camera, at in outcome.cameras.items() if at is None]:
                outcome.cameras[camera] = self._back(camera, over)
            processes = self._arena.site.processes()
            for label in [label for label, at in outcome.nodes.items() if at is None]:
                pid = processes.get(label)
                if pid not in (None, former.get(label)) and self._heartbeats.since(label, over):
                    outcome.nodes[label] = time.monotonic() - over
                    outcome.waited = max(outcome.waited, waited_s(processes[label]))
            if None not in (*outcome.cameras.values(), *outcome.nodes.values()):
                return
            time.sleep(0.4)
        for label in nodes:
            pid = self._arena.site.processes().get(label)
            if pid is not None and pid == former.get(label):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)

    def _back(self, camera: str, over: float) -> float | None:
        sent = [frame for frame in self._arena.cameras.sent_of(camera) if frame.at > over]
        told = [self._acknowledgements.when(frame.stamp_ns) for frame in sent]
        return min((at - over for at in told if at is not None), default=None)

    def _longest_gap(self, camera: str, begun: float, end: float) -> float:
        """Between two acknowledgements of a camera, the last before `begun` and up to `end`."""
        told = (self._acknowledgements.when(frame.stamp_ns) for frame in self._arena.cameras.sent_of(camera))
        times = sorted(at for at in told if at is not None and at <= end)
        before = [at for at in times if at < begun]
        moments = [*before[-1:], *(at for at in times if at >= begun), end]
        return max((later - earlier for earlier, later in pairwise(moments)), default=0.0)
