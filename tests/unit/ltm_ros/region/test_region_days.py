"""A region over simulated days, a fault in each minute: no frame lost, none twice, nothing stuck, nothing leaks."""

from __future__ import annotations

import gc
import threading
import time
from pathlib import Path

import pytest
from scenes.region_days import FAULTS, RegionDays, same_map
from scenes.region_scene import CAMERA, TOWERS, write_region_scene


@pytest.mark.parametrize("hours", [0.25, pytest.param(48.0, marks=pytest.mark.slow)])
def test_after_a_fault_in_each_minute_the_map_is_that_of_all_frames(tmp_path: Path, hours: float) -> None:
    days, begun, minutes = RegionDays(write_region_scene(tmp_path), seed=7), time.monotonic(), round(60 * hours)
    days.run(minutes // 5)
    early = open_things()
    days.run(minutes - minutes // 5)
    assert sum(days.faults.values()) == minutes
    if minutes > 100:
        assert set(days.faults) == set(FAULTS)
    days.drain(60)
    late = open_things()
    assert days.waiting == 0, "no tower is stuck"
    frames = {name: len(seconds) for name, seconds in days.sent.items()}
    assert all(abs(number - 60 * minutes // days.period_s) <= 1 for number in frames.values())
    assert days.stored() == {f"{name}_{CAMERA}": frames[name] for name in TOWERS}, "each once"
    assert same_map(days.evidence, days.expected())
    days.close()
    assert set(days.dropped) <= {"message"}, "what was altered, and nothing else"
    print(
        f"{hours:g} simulated hours in {time.monotonic() - begun:.0f} s, {sum(frames.values())} frames, faults "
        f"{dict(days.faults)}, refused {dict(days.dropped)}, files, threads and objects {early} -> {late}"
    )
    files, threads, objects = (b - a for a, b in zip(early, late, strict=True))
    assert files <= 4
    assert threads <= 0
    assert objects < 50_000


def open_things() -> tuple[int, int, int]:
    """Open files, threads, and objects that the garbage collector knows."""
    gc.collect()
    return len(list(Path("/proc/self/fd").iterdir())), threading.active_count(), len(gc.get_objects())
