"""What the soak measures, and the slope that it fits."""

from __future__ import annotations

import mmap
import os
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
from chaos import report
from chaos.resources import waited_s
from chaos.soak import SUM, Growth, Sample, Soak

from ltm_core.base.resources import project_path
from ltm_lab.bench.process_usage import Usage, usage
from ltm_ros.runtime.process_memory import MemoryInUse

_BYTES = 10_000 * mmap.PAGESIZE


def test_usage_of_this_process(tmp_path: Path) -> None:
    before = usage(os.getpid())
    assert before is not None
    done = threading.Event()
    thread = threading.Thread(target=done.wait)
    thread.start()
    with (tmp_path / "open").open("wb"):
        block = mmap.mmap(-1, _BYTES)  # not from a heap that may have had it already
        block[:: mmap.PAGESIZE] = bytes(_BYTES // mmap.PAGESIZE)
        after = usage(os.getpid())
    done.set()
    thread.join()
    assert after is not None
    assert after.private - before.private > 0.9 * _BYTES / 1024
    assert after.own - before.own > 0.9 * _BYTES / 1024
    assert after.pss - before.pss > 0.9 * _BYTES / 1024
    assert after.descriptors - before.descriptors == 1
    assert after.threads - before.threads == 1
    assert usage(2**22 + 1) is None
    assert waited_s(os.getpid()) > 0
    assert waited_s(2**22 + 1) == 0


def _soak(minutes: float, *memory: Callable[[float], float]) -> Soak:
    """Samples each 5 s of processes whose own memory, kB, is a function of the minutes."""
    soak = Soak()
    for minute in np.arange(12 * minutes + 1) / 12:
        own = {str(number): round(kb(minute)) for number, kb in enumerate(memory)}
        # What is private changes as programs come and go that have mapped the same files.
        usage = {label: Usage(0, kb + round(900 * minute) % 7000, kb, 9, 3, 0.0) for label, kb in own.items()}
        soak.samples.append(Sample(60 * minute, usage))
    return soak


def test_growth_is_that_of_the_last_two_thirds() -> None:
    """One process fills a cache and then keeps 12 kB a minute, with a sample that is out; another stands still."""
    soak = _soak(45, lambda t: 5000 + min(900 * t, 9000) + 12 * t + (4000 if t == 35 else 0), lambda _: 700)
    soak.samples[2].usage["ended early"] = Usage(0, 10**6, 10**6, 9, 3, 0.0)
    growth = soak.growth()
    assert growth.keys() == {"0", "1", SUM}
    assert growth["1"] == Growth(0.0, 0.0, 0.0, 0.0, 0.0)
    total = growth[SUM]
    np.testing.assert_allclose((total.slope, growth["0"].slope), 12.0, atol=0.2)
    assert total.low <= total.slope <= total.high < 13.0
    np.testing.assert_allclose(total.grown, 12.0 * 30 * 7 / 8, rtol=0.05)
    assert soak.missed() == ["memory grows by 12.0 kB a minute in sum"]
    assert _soak(29, lambda t: 12 * t).missed() == []


def test_what_comes_and_goes_each_minute_is_no_growth() -> None:
    """Twelve samples a minute: until it gives back once a minute, what a process holds grows by 4 MB, evenly or not."""
    for swing in (lambda part: 4000 * part, lambda part: 4000 * (part > 0.3)):
        soak = _soak(60, lambda t, swing=swing: 5000 + 3 * t + swing(t % 1))  # type: ignore[misc]
        np.testing.assert_allclose(soak.growth()["0"].slope, 3.0, atol=0.2)


def test_a_single_step_is_no_slope_and_is_told() -> None:
    for at in (20, 27, 40):
        soak = _soak(45, lambda t, at=at: 5000 + (2048 if t >= at else 0), lambda _: 700)  # type: ignore[misc]
        total = soak.growth()[SUM]
        assert (total.slope, total.grown, total.largest_step) == (0.0, 2048.0, 2048.0)
        assert soak.missed() == []


def test_the_report_names_what_each_process_keeps() -> None:
    soak = _soak(45, lambda _: 5000)
    for sample in soak.samples:
        sample.usage["recorder"] = sample.usage["0"]
    lines = list(report.growth(soak.growth(), {}))
    row = next(number for number, line in enumerate(lines) if line.startswith("  recorder"))
    assert lines[row + 1] == "    keeps the index of the file at hand, which ends after 10 minutes"


def test_growth_in_use_is_told_by_process_and_is_not_that_of_holes() -> None:
    """Both processes ask for 20 kB a minute; the objects of one grow by 4 of them, those of the other by none."""
    soak = _soak(45, lambda t: 5000 + 20 * t, lambda t: 6000 + 20 * t)
    for sample in soak.samples:
        minute = sample.seconds / 60
        grows = MemoryInUse(4096 * round(1000 + minute), 70 + 3 * round(2 * minute))
        soak.in_use.append({"0": grows, "1": MemoryInUse(9 << 20, 800)})
    soak.in_use[5]["came late"] = MemoryInUse(5, 5)
    found = soak.growth_in_use()
    assert found.keys() == {"0", "1"}
    np.testing.assert_allclose([found["0"].heap_kb.slope, found["0"].python_blocks.slope], [4.0, 6.0], rtol=0.01)
    assert (found["1"].heap_kb.slope, found["1"].python_blocks.slope) == (0.0, 0.0)
    *_, first, second, total, _ = report.growth(soak.growth(), found)
    assert first.split(";")[-1].split() == ["4.0", "(4.0", "to", "4.0),", "6"]
    assert second.split(";")[-1].split() == ["0.0", "(0.0", "to", "0.0),", "0"]
    assert total.split()[:3] == ["in", "sum", "40.0"]


def test_pages_of_files_are_not_a_process_own() -> None:
    """They are private only as long as no other process has mapped the file."""
    path = project_path("bags/demo/recording/recording_0.mcap")
    kb = path.stat().st_size / 1024
    with path.open("rb") as file:
        before = usage(os.getpid())
        with mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ) as mapped:
            assert mapped[:: mmap.PAGESIZE]
            after = usage(os.getpid())
    assert before is not None
    assert after is not None
    assert after.private - before.private > 0.9 * kb
    assert after.own - before.own < 0.1 * kb
