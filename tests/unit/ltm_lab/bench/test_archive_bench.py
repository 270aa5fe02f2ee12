"""The archive benchmark: the simulated month, and the speed of two processes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from scenes.small_site import FRAMES, write_small_site

from ltm_core.base.errors import ArchiveError
from ltm_core.base.number_text import DAY_NS
from ltm_lab.bench.archive import TimedReport, WorkedPlan, measure_speedup, write_days
from ltm_lab.bench.archive_month import MonthResult, MonthRun, measure_month
from ltm_lab.bench.colour_network import write_colour_network
from ltm_ros.archive.plan import Task, TaskSettings
from ltm_ros.archive.run import ArchiveOptions, Plan, look_through
from ltm_ros.archive.task import Done

COLOURS = {"sky": (200, 210, 235), "soil": (175, 160, 150), "tree": (35, 75, 35)}


def test_the_network_reads_the_nearest_colour(tmp_path: Path) -> None:
    write_colour_network(tmp_path, COLOURS, {"sky": "sky", "soil": "bare", "tree": "tree"}, (8, 4))
    picture = np.zeros((1, 3, 4, 8), np.float32)
    picture[..., :4] = (np.array(COLOURS["tree"]) + 12)[:, None, None] / 255
    picture[..., 4:] = (np.array(COLOURS["soil"]) - 15)[:, None, None] / 255
    (scores,) = onnxruntime.InferenceSession(str(tmp_path / "colours.onnx")).run(None, {"image": picture})
    assert scores.argmax(axis=1)[0].tolist() == [[2, 2, 1, 1]] * 2


def result(different: int, *digests: str) -> MonthResult:
    runs = tuple(MonthRun("a way", digest, 1, 0.0, 0.0) for digest in digests)
    return MonthResult(9, runs, 2000, 1.0, 4, {}, different, 1.0, "")


def test_what_holds() -> None:
    assert result(2, "a", "a").holds
    assert not result(3, "a", "a").holds
    assert not result(0, "a", "b").holds


@pytest.mark.slow
def test_a_drawn_day_gives_one_map_on_all_ways(tmp_path: Path) -> None:
    found = measure_month(tmp_path, 1, lambda words: None, 5)
    assert found.frames == 48
    assert len(found.runs) == 3
    assert len({one.digest for one in found.runs}) == 1
    # A day of UTC has parts of two days of the sun.
    assert 6 <= found.sample_frames <= 16
    assert 0 < found.different < found.seen
    assert Path(found.page).is_file()


def test_a_recording_is_repeated_on_each_day(tmp_path: Path) -> None:
    small_site = write_small_site(tmp_path)
    long = write_days(small_site.bag, tmp_path / "long", 3)

    def planned(bag: Path) -> Plan:
        out = str(tmp_path / bag.name)
        return look_through(ArchiveOptions((bag,), small_site.path, out), lambda done, total: None)

    one, three = planned(small_site.bag), planned(long)
    assert (len(one.tasks), len(three.tasks), three.manifest.failures) == (2, 6, [])
    moved = {(f.camera, f.stamp_ns + day * DAY_NS, f.content) for f in one.frames for day in range(3)}
    assert {(f.camera, f.stamp_ns, f.content) for f in three.frames} == moved
    assert len(moved) == 3 * 2 * FRAMES
    with pytest.raises(ArchiveError, match="2 days make 4 tasks, too few"):
        measure_speedup(small_site.bag, small_site.path, tmp_path, 2, lambda words: None)


def test_the_warm_up_is_not_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of eight tasks takes 2 s in a worker, the first two more; the engine takes 0.1 s each. Clocks are set."""
    small_site = write_small_site(tmp_path)
    days = write_days(small_site.bag, tmp_path / "days", 4)
    planned = look_through(ArchiveOptions((days,), small_site.path, str(tmp_path / "out")), lambda done, total: None)
    wall, engine = (iter(5.0 + step * np.arange(8)) for step in (0.5, 0.1))
    monkeypatch.setattr("ltm_lab.bench.archive.time.perf_counter", lambda: next(wall))
    monkeypatch.setattr("ltm_lab.bench.archive.time.process_time", lambda: next(engine))

    def timed(tasks: Sequence[Task], settings: TaskSettings) -> Iterator[Done]:
        for number, task in enumerate(tasks):
            yield Done(task, TimedReport(FRAMES, 2.0 if number >= 2 else 70.0))

    found = WorkedPlan(planned, timed)
    assert found.engine_share(2) == pytest.approx(0.6 / 12.6)
    assert found.own_cpu_s(2) == pytest.approx(0.6)
    assert found.frames(2) == 6 * FRAMES
    # Of five tasks between the second and the seventh, the last one left out.
    assert found.rate(2, 1) == pytest.approx(5 * FRAMES / 2.5)


@pytest.mark.slow
def test_two_processes_are_measured_against_one(tmp_path: Path) -> None:
    small_site = write_small_site(tmp_path)
    found = measure_speedup(small_site.bag, small_site.path, tmp_path, 6, lambda words: None)
    assert (found.tasks, found.frames) == (12, FRAMES)
    assert min(found.times, found.alone_cpu_s) > 0
    assert 0 < found.engine_share < 1
