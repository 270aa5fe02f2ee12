"""A thousand connections, made and lost, leave no thread, no descriptor and no memory behind."""

from __future__ import annotations

import gc
import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from scenes.http_camera import Behaviour, HttpCamera, running
from scenes.source_under_test import Sourced, settings
from scenes.timed_picture import jpeg, scene
from scenes.waiting import wait_for

from ltm_ros.runtime.clocks import SystemClock

RECONNECTS, WARM_UP, STREAMS = 1000, 100, 100
GROWTH_KB = 12_000


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def threads() -> int:
    """Those of libraries too."""
    return len(list(Path("/proc/self/task").iterdir()))


def resident_kb() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") // 1024


def grown(connect: Callable[[], object], count: int, warm_up: int) -> int:
    """Memory that came to stay, kB; threads and descriptors must be gone."""
    for _ in range(warm_up):
        connect()
    gc.collect()
    before, running_before, memory = descriptors(), threads(), resident_kb()
    for _ in range(count):
        connect()
    gc.collect()
    # The server of the test ends its own side of a connection in its own time.
    wait_for(lambda: descriptors() <= before + 4, "descriptors", lambda: (before, descriptors()))
    wait_for(lambda: threads() <= running_before + 2, "threads", lambda: threading.enumerate())
    return resident_kb() - memory


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["snapshot", "mjpeg"])
def test_a_thousand_reconnects_leave_nothing_behind(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    monkeypatch.setenv("NORTH", "tower-%7 secret")
    pictures = [jpeg(scene()) for _ in range(10)]
    numbers = iter(range(10**9))
    behaviour = Behaviour(
        authentication="digest", frame_s=0.0, render=lambda _: pictures[next(numbers) % len(pictures)]
    )
    with running(HttpCamera(behaviour)) as camera:
        path = "/snapshot.jpg" if kind == "snapshot" else "/stream.mjpg"
        login = {"user": "viewer", "password": {"environment": "NORTH"}}
        sourced = Sourced(
            settings(kind=kind, url=camera.url(path), **({"every": 1} if kind == "snapshot" else {}), **login),
            SystemClock(),
        )

        def connect() -> None:
            # Every third connection breaks off by itself, the others are ended by us.
            camera.behaviour.cut = len(sourced.frames) % 3 == 2
            sourced.steps(1)
            sourced.source.close()
            camera.behaviour.cut = False
            sourced.steps(1)
            sourced.source.close()
            del sourced.frames[:-9]
            sourced.frames.append(sourced.frames[-1])

        grew = grown(connect, RECONNECTS // 2, WARM_UP // 2)
    assert int(sourced.health.summary()["noted.connected"]) >= RECONNECTS
    assert grew < GROWTH_KB
