"""A whole run: the graph comes up, cameras send, something happens for so long, all stops in order, and is judged."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from bystander import Bystander
from scenes.compiled_kernels import compile_kernels
from scenes.small_site import SmallSite
from scenes.waiting import wait_for

from chaos import report
from chaos.acknowledgements import Acknowledgements
from chaos.cameras import CAMERAS, Cameras, Photos
from chaos.chaos_run import MOST_MORE, ChaosRun, Outcome
from chaos.disks import mount_disk, unmount_disk
from chaos.faults import Arena
from chaos.heartbeats import Heartbeats
from chaos.living_site import write_living_site
from chaos.running_site import RunningSite
from chaos.soak import Soak
from chaos.verdict import judge, votes_of_phases
from ltm_core.base.errors import RecordingError
from ltm_lab.bench.process_usage import Usage, usage_of
from ltm_msgs_py.bag.reader import BagReader
from ltm_ros.launching import shared_memory

DISK_MB = {"state": 320, "recording": 640}
"""More than `ltm run` asks for before it starts."""
START_S = 300.0
"""For the first frames."""
ENDING_S = 20.0
"""For frames that are on their way when the cameras stop."""
RESTED_S = 3.0
"""Without an acknowledgement, after which none is on its way."""


@dataclass
class Found:
    """`content`: all of it, for JSON. `missed`: what is not as it must be."""

    content: dict[str, Any] = field(default_factory=dict)
    missed: list[str] = field(default_factory=list)


class Stage:
    """A running site with its cameras, and those who look at it."""

    def __init__(
        self, folder: Path, domain: int, period_s: float, processes: str, bystander: Bystander, own_disks: bool
    ) -> None:
        compile_kernels()  # of which no node that comes back shall think
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "site").mkdir()
        self.small: SmallSite = write_living_site(folder / "site", processes)
        self.photos = Photos(self.small)
        self.disks = {name: folder / name for name in DISK_MB} if own_disks else {}
        for name, disk in self.disks.items():
            mount_disk(disk, DISK_MB[name])
        self.state = folder / "state"
        self.recording = folder / "recording" / "bag"
        self.site = RunningSite(self.small.path, self.state, self.recording, folder / "logs", domain)
        self.cameras = Cameras(bystander.node, self.photos, period_s)
        self.acknowledgements = Acknowledgements(bystander.node)
        self.heartbeats = Heartbeats(bystander.node, self.small.site.name, self.site.nodes)
        self.first_usage: dict[str, Usage] = {}

    def begin(self) -> None:
        """Returns when frames of all cameras are told of and all nodes report."""
        begun = time.monotonic()
        self.site.start()
        self.cameras.start()

        def waits_for() -> list[str]:
            told = self.acknowledgements.snapshot()
            dark = [camera for camera in CAMERAS if not any(s.stamp_ns in told for s in self.cameras.sent_of(camera))]
            return dark + [label for label in self.site.nodes if not self.heartbeats.since(label, begun)]

        wait_for(lambda: not waits_for(), "a whole graph", waits_for, START_S)
        print(f"{len(self.site.nodes)} processes at work after {time.monotonic() - begun:.0f} s", flush=True)
        self.first_usage = usage_of(self.site.processes())

    def end(self) -> list[str]:
        """Stop the cameras, let what is on its way arrive, stop the graph in order; what of this went wrong."""
        self.cameras.stop()
        deadline, told, since = time.monotonic() + ENDING_S, -1, time.monotonic()
        while time.monotonic() < deadline and time.monotonic() - since < RESTED_S:
            if (now := len(self.acknowledgements.snapshot())) != told:
                told, since = now, time.monotonic()
            time.sleep(0.1)
        missed = []
        last = usage_of(self.site.processes())
        for label, first in self.first_usage.items():
            for what, most in MOST_MORE.items():
                more = getattr(last[label], what) - getattr(first, what) if label in last else 0
                missed += [f"{label} has {more} more {what} than at first"] if more > most else []
        if status := self.site.stop():
            missed.append(f"the graph stopped with exit code {status}")
        if left := self.site.left:
            missed.append(f"processes left behind: {', '.join(left)}")
        time.sleep(1.0)  # the last acknowledgements
        return missed

    def judge(self, found: Found) -> None:
        """Into `found`."""
        told = {stamp: len(times) for stamp, times in self.acknowledgements.snapshot().items()}
        verdict = judge(self.small, self.state, self.cameras.sent, told, votes_of_phases(self.small, self.photos))
        print(report.counts(verdict))
        found.content["verdict"] = asdict(verdict)
        found.missed += [f"{len(verdict.lost)} acknowledged frames are lost"] if verdict.lost else []
        found.missed += [f"{len(verdict.told_twice)} frames were told of twice"] if verdict.told_twice else []
        found.missed += verdict.faults
        found.missed += self._damaged_recordings()

    def _damaged_recordings(self) -> list[str]:
        """The graph has stopped in order, so whatever happened to recorders before, all files must be whole."""
        damaged, messages = [], 0
        for bag in sorted(self.recording.parent.glob(f"{self.recording.name}*")):
            try:
                reader = BagReader(bag)
                messages += sum(1 for _ in reader.messages())
                damaged += [f"{bag.name}: {note}" for note in reader.damage]
            except RecordingError as error:
                damaged.append(str(error))
        print(f"{messages} messages in the recordings that are left")
        return damaged


@contextmanager
def on_stage(
    folder: Path, domain: int, period_s: float, processes: str, own_disks: bool, found: Found
) -> Iterator[Stage]:
    """The body has a whole graph; after it, all is stopped and judged."""
    with Bystander() as bystander:
        stage = Stage(folder, domain, period_s, processes, bystander, own_disks)
        try:
            stage.begin()
            yield stage
        except BaseException:
            stage.cameras.stop()
            stage.site.stop()
            raise
        found.content["counted"] = dict(stage.heartbeats.counted())
        found.missed += stage.end()
    # Of strangers that were ended, who had no runner to clean up after them, and of killed nodes: a port that this
    # process sent to counts as one in use until its bystander is gone.
    shared_memory.remove_stale()
    stage.judge(found)
    for disk in stage.disks.values():
        unmount_disk(disk)


def play_chaos(
    folder: Path,
    domain: int,
    period_s: float,
    processes: str,
    minutes: float,
    kinds: list[str],
    rng: random.Random,
    own_disks: bool,
    slack: float,
) -> Found:
    """Faults of these kinds, by chance, for so long."""
    found = Found()
    with on_stage(folder, domain, period_s, processes, own_disks, found) as stage:
        arena = Arena(stage.site, stage.cameras, stage.disks)
        print(report.heading(), flush=True)
        tell: Callable[[Outcome], None] = lambda outcome: print(report.line(outcome), flush=True)  # noqa: E731
        run = ChaosRun(arena, stage.acknowledgements, stage.heartbeats, kinds, rng, tell, slack)
        run.run(minutes)
    print("counted by the processes that lived at the end:", *report.causes(found.content["counted"]), sep="\n")
    found.content["faults"] = [asdict(outcome) for outcome in run.outcomes]
    found.missed += [f"{outcome.fault}: {text}" for outcome in run.outcomes for text in outcome.missed]
    return found


def play_soak(folder: Path, domain: int, period_s: float, processes: str, minutes: float) -> Found:
    """No faults."""
    found, soak = Found(), Soak()
    with on_stage(folder, domain, period_s, processes, False, found) as stage:
        soak.watch(stage.site, minutes, lambda text: print(text, flush=True))
    growth = soak.growth()
    print(*report.growth(growth), sep="\n")
    found.missed += soak.missed()
    if strangers := sorted(stage.heartbeats.strangers):
        found.missed.append(f"another graph was in the domain ({', '.join(strangers[:3])}...): nothing is said by this")
    found.content["soak"] = asdict(soak) | {
        "growth": {label: asdict(one) for label, one in growth.items()},
    }
    return found
