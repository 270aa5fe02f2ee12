"""A whole run: the graph comes up, cameras send, something happens for so long, all stops in order, and is judged."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bystander import Bystander
from scenes.compiled_kernels import compile_kernels
from scenes.waiting import wait_for

from chaos.cameras import CAMERAS, Cameras, Photos
from chaos.disks import mount_disk, unmount_disk
from chaos.listener import Listener
from chaos.living_site import write_living_site
from chaos.running_site import RunningSite
from chaos.verdict import judge
from ltm_core.base.errors import RecordingError
from ltm_lab.bench.process_usage import usage_of
from ltm_msgs_py.bag.reader import BagReader
from ltm_ros.launching import shared_memory

DISK_MB = {"state": 320, "recording": 640}
"""More than `ltm run` asks for before it starts."""
PERIOD_S = 1.0
"""Between two frames of a camera."""
START_S = 300.0
"""For the first frames."""
ENDING_S = 20.0
"""For frames that are on their way when the cameras stop."""
RESTED_S = 3.0
"""Seconds without an announcement after which no further one is expected."""
MOST_MORE = {"descriptors": 32, "threads": 16}
"""By which a process may have more of them at its end than when it was first whole."""


class Stage:
    """A running site with its cameras, and who listens to it."""

    def __init__(self, folder: Path, domain: int, bystander: Bystander, own_disks: bool) -> None:
        compile_kernels()  # a restarted node must not spend its time on this
        (folder / "site").mkdir()
        self.small = write_living_site(folder / "site")
        self.photos = Photos(self.small)
        self.disks = {name: folder / name for name in DISK_MB} if own_disks else {}
        for name, disk in self.disks.items():
            mount_disk(disk, DISK_MB[name])
        self.state, self.recording = folder / "state", folder / "recording" / "bag"
        self.site = RunningSite(self.small.path, self.state, self.recording, folder / "logs", domain)
        self.cameras = Cameras(bystander.node, self.photos, PERIOD_S)
        self.listener = Listener(bystander.node)

    def begin(self) -> None:
        """Return when frames of all cameras have been announced and all nodes have reported."""
        begun = time.monotonic()
        self.site.start()
        self.cameras.start()

        def waits_for() -> list[str]:
            announced = self.listener.announced()
            dark = [
                camera for camera in CAMERAS if not any(s.stamp_ns in announced for s in self.cameras.sent_of(camera))
            ]
            return dark + [label for label in self.site.nodes if not self.listener.reported_since(label, begun)]

        wait_for(lambda: not waits_for(), "a whole graph", waits_for, START_S)
        print(f"{len(self.site.nodes)} processes at work after {time.monotonic() - begun:.0f} s", flush=True)
        self.first_usage = usage_of(self.site.processes())

    def end(self) -> list[str]:
        """Stop the cameras, let what is on its way arrive, stop the graph in order; what of this went wrong."""
        self.cameras.stop()
        deadline, announced, since = time.monotonic() + ENDING_S, -1, time.monotonic()
        while time.monotonic() < deadline and time.monotonic() - since < RESTED_S:
            if (now := len(self.listener.announced())) != announced:
                announced, since = now, time.monotonic()
            time.sleep(0.1)
        last = usage_of(self.site.processes())
        missed = [
            f"{label} has many more {what} than at first"
            for label in self.first_usage.keys() & last.keys()
            for what, most in MOST_MORE.items()
            if getattr(last[label], what) - getattr(self.first_usage[label], what) > most
        ]
        if status := self.site.stop():
            missed.append(f"the graph stopped with exit code {status}")
        missed += [f"{label} was left behind" for label in self.site.left]
        missed += [f"another graph was in the domain: {name}" for name in sorted(self.listener.strangers)[:3]]
        time.sleep(1.0)  # the last announcements
        return missed

    def damaged_recordings(self) -> list[str]:
        """The graph has stopped in order, so whatever happened to recorders before, all files must be whole."""
        damaged = []
        for bag in sorted(self.recording.parent.glob(f"{self.recording.name}*")):
            try:
                reader = BagReader(bag)
                assert any(True for _ in reader.messages()), f"{bag} is empty"
                damaged += [f"{bag.name}: {note}" for note in reader.damage]
            except RecordingError as error:
                damaged.append(str(error))
        return damaged


@contextmanager
def on_stage(folder: Path, domain: int, own_disks: bool, missed: list[str]) -> Iterator[Stage]:
    """The body has a whole graph; after it, all is stopped and judged."""
    with Bystander() as bystander:
        stage = Stage(folder, domain, bystander, own_disks)
        try:
            stage.begin()
            yield stage
        except BaseException:
            stage.cameras.stop()
            stage.site.stop()
            raise
        missed += stage.end()
    # Segments of killed nodes: a port that this process sent to counts as in use until its bystander is gone.
    shared_memory.remove_stale()
    missed += judge(stage.small, stage.state, stage.cameras.sent, stage.listener.announced(), stage.photos)
    missed += stage.damaged_recordings()
    for disk in stage.disks.values():
        unmount_disk(disk)
