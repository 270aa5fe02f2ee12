"""The faults that are injected: each draws what it needs, acts, and says whom it touched."""

import contextlib
import os
import random
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from chaos.cameras import CAMERAS, Cameras
from chaos.running_site import RunningSite
from ltm_ros.launching.graph import CAMERAS_PROCESS

ORPHANS_S = 15.0
"""In which all nodes are gone after their runner was killed."""


@dataclass(frozen=True)
class Arena:
    """What faults are done to. `disks`: file systems of their own, by what lies there."""

    site: RunningSite
    cameras: Cameras
    disks: dict[str, Path]


@dataclass(frozen=True)
class Fault:
    """`touches`: cameras whose frames may be lost meanwhile; the others go on. `restarts`: labels of the processes
    that others must take the place of. `act` returns when the fault is over, with what was not as it must be."""

    name: str
    act: Callable[[], list[str]]
    touches: tuple[str, ...] = CAMERAS
    restarts: tuple[str, ...] = ()
    whole_start: bool = False
    """Whether it ends the graph, so that all of it must start again."""


Draw = Callable[[Arena, random.Random], Fault]


def kill(arena: Arena, rng: random.Random) -> Fault:
    """SIGKILL to a node."""
    return _signalled(arena, rng, signal.SIGKILL, "kill")


def terminate(arena: Arena, rng: random.Random) -> Fault:
    """SIGTERM to a node, which then ends in order while the graph lives on."""
    return _signalled(arena, rng, signal.SIGTERM, "terminate")


def hang(arena: Arena, rng: random.Random) -> Fault:
    """SIGSTOP to a node: it neither works nor ends."""
    return _signalled(arena, rng, signal.SIGSTOP, "hang")


def hesitate(arena: Arena, rng: random.Random) -> Fault:
    """SIGSTOP to a node and, before anybody gives it up, SIGCONT."""
    label, seconds = _node(arena, rng), rng.uniform(0.5, 3.0)

    def act() -> list[str]:
        pid = arena.site.processes().get(label)
        if pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGSTOP)
                time.sleep(seconds)
                os.kill(pid, signal.SIGCONT)
        return []

    return Fault(f"hesitate {label} {seconds:.1f} s", act, _touched(label))


def kill_runner(arena: Arena, rng: random.Random) -> Fault:
    """SIGKILL to the runner: all nodes must end, then it is started again."""

    def act() -> list[str]:
        arena.site.kill_runner()
        left = arena.site.wait_gone(ORPHANS_S)
        for pid in arena.site.processes().values():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        arena.site.start()
        return [f"{len(left)} orphans after {ORPHANS_S:.0f} s: {', '.join(left)}"] if left else []

    return Fault("kill runner", act, whole_start=True)


def fill_disk(arena: Arena, rng: random.Random) -> Fault:
    """A disk is filled to the last byte, and some seconds later has room again."""
    name, seconds = rng.choice(sorted(arena.disks)), rng.uniform(3.0, 12.0)

    def act() -> list[str]:
        ballast = arena.disks[name] / "ballast"
        try:
            with ballast.open("wb", buffering=0) as file, contextlib.suppress(OSError):
                while True:
                    file.write(bytes(1 << 20))
            with ballast.open("ab", buffering=0) as file, contextlib.suppress(OSError):
                while True:
                    file.write(bytes(1 << 9))
            time.sleep(seconds)
        finally:
            ballast.unlink(missing_ok=True)
        return []

    return Fault(f"full disk of {name} {seconds:.0f} s", act, CAMERAS if name == "state" else ())


def step_clock(arena: Arena, rng: random.Random) -> Fault:
    """Make a camera's clock wrong for some seconds; frames that are rejected for it must not be announced."""
    camera, seconds = rng.choice(CAMERAS), rng.uniform(3.0, 8.0)
    error_s = rng.choice((3.0, 45.0, 3600.0, -3.0, -3600.0, -30 * 86400.0, -50 * 365 * 86400.0))

    def act() -> list[str]:
        arena.cameras.clock_error_s[camera] = error_s
        time.sleep(seconds)
        arena.cameras.clock_error_s[camera] = 0.0
        return []

    return Fault(f"clock of {camera} {error_s:+.0f} s for {seconds:.0f} s", act, (camera,))


def unknown_covariance(arena: Arena, rng: random.Random) -> Fault:
    """Poses of the tower say for some seconds that they are not known at all: covariances of the greatest double."""
    seconds = rng.uniform(3.0, 6.0)

    def act() -> list[str]:
        arena.cameras.unknown_covariance = True
        time.sleep(seconds)
        arena.cameras.unknown_covariance = False
        return []

    return Fault(f"covariances of DBL_MAX {seconds:.0f} s", act, ())


def repeat_frames(arena: Arena, rng: random.Random) -> Fault:
    """A camera sends its last frames once more."""
    camera, count = rng.choice(CAMERAS), rng.randrange(1, 30)

    def act() -> list[str]:
        for sent in [sent for sent in arena.cameras.sent if sent.camera == camera][-count:]:
            arena.cameras.repeat(sent)
        return []

    return Fault(f"{camera} repeats {count} frames", act, (camera,))


def flood_frames(arena: Arena, rng: random.Random) -> Fault:
    """A camera sends true frames far faster than they can be worked on."""
    camera, rate, seconds = rng.choice(CAMERAS), rng.uniform(10.0, 30.0), rng.uniform(2.0, 6.0)

    def act() -> list[str]:
        begun = time.monotonic()
        for number in range(round(rate * seconds)):
            arena.cameras.send(camera)
            time.sleep(max(0.0, begun + (number + 1) / rate - time.monotonic()))
        return []

    return Fault(f"{camera} sends {rate:.0f} frames/s for {seconds:.0f} s", act)


FAULTS: dict[Draw, int] = {
    **{kill: 4, terminate: 1, hang: 3, hesitate: 1, kill_runner: 1, fill_disk: 2, step_clock: 1},
    **{unknown_covariance: 1, repeat_frames: 1, flood_frames: 1},
}
"""How often each is drawn."""


def draw_fault(arena: Arena, rng: random.Random) -> Fault:
    """One by chance; kills and hangs oftener."""
    kinds = {draw: weight for draw, weight in FAULTS.items() if arena.disks or draw is not fill_disk}
    (draw,) = rng.choices([*kinds], [*kinds.values()])
    return draw(arena, rng)


def _node(arena: Arena, rng: random.Random) -> str:
    return rng.choice(arena.site.nodes)


def _touched(label: str) -> tuple[str, ...]:
    """A node of the site touches all cameras where their frames go through it, or wait at their door for it."""
    camera, _, name = label.rpartition("/")
    if camera:
        return (camera,)
    return CAMERAS if name in ("fuel_map", "terrain", CAMERAS_PROCESS) else ()


def _signal(arena: Arena, label: str, number: int) -> list[str]:
    pid = arena.site.processes().get(label)
    if pid is None:
        return [f"{label} did not run"]
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, number)
    return []


def _signalled(arena: Arena, rng: random.Random, number: int, verb: str) -> Fault:
    label = _node(arena, rng)
    return Fault(f"{verb} {label}", lambda: _signal(arena, label, number), _touched(label), (label,))
