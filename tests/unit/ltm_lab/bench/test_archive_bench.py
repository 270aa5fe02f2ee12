"""The simulated month and what is measured on it."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from scenes.small_site import FRAMES, write_small_site

from ltm_core.base.errors import ArchiveError
from ltm_core.base.utc_time import DAY_NS
from ltm_lab.bench.archive import Way
from ltm_lab.bench.archive_kills import run_under_kills
from ltm_lab.bench.archive_month import MonthBench, SampleCost, measure_looks, measure_month, resumed
from ltm_lab.bench.archive_speedup import WorkedPlan, measure_speedup, write_days
from ltm_lab.bench.archive_worker import TimedReport, engine_cost, engine_share, worker_cost
from ltm_lab.bench.colour_network import write_colour_network
from ltm_lab.bench.simulated_month import DRAW
from ltm_ros.archive.engine import Done, serial
from ltm_ros.archive.plan import Task, TaskSettings
from ltm_ros.archive.run import ArchiveOptions, Plan, look_through, run

COLOURS = {"sky": (200, 210, 235), "soil": (175, 160, 150), "tree": (35, 75, 35)}


def test_the_network_reads_the_nearest_colour(tmp_path: Path) -> None:
    write_colour_network(tmp_path, COLOURS, {"sky": "sky", "soil": "bare", "tree": "tree"}, (8, 4))
    picture = np.zeros((1, 3, 4, 8), np.float32)
    picture[..., :4] = (np.array(COLOURS["tree"]) + 12)[:, None, None] / 255
    picture[..., 4:] = (np.array(COLOURS["soil"]) - 15)[:, None, None] / 255
    (scores,) = onnxruntime.InferenceSession(str(tmp_path / "colours.onnx")).run(None, {"image": picture})
    assert scores.argmax(axis=1)[0].tolist() == [[2, 2, 1, 1]] * 2


def bench(different: int, *digests: str) -> MonthBench:
    ways = tuple(Way("a way", digest, 1, 0.0, 0.0) for digest in digests)
    samples = SampleCost("4/day", 4, {}, different, 1.0), SampleCost("8/day", 8, {}, 900, 1.0)
    return MonthBench(9, ways, ways[:1], 2000, 1.0, samples, "")


def test_what_holds() -> None:
    assert bench(2, "a", "a").holds
    assert not bench(3, "a", "a").holds
    assert not bench(0, "a", "b").holds


@pytest.mark.slow
def test_a_drawn_day_gives_one_map_on_all_ways(tmp_path: Path) -> None:
    found = measure_month(tmp_path, 1, lambda words: None)
    assert found.frames == 48
    assert {len({way.digest for way in ways}) for ways in (found.ways, found.burned_ways)} == {1}
    assert [one.sample for one in found.samples] == ["4/day", "8/day"]
    # A day of UTC has parts of two days of the sun.
    assert 6 <= found.samples[0].frames <= 16
    assert found.samples[0].frames < found.samples[1].frames <= 32
    assert Path(found.page).is_file()
    assert found.resumed is not None
    assert found.resumed.tasks == 48
    # The short way, without layers, page and other ways, tells the same.
    (tmp_path / "short").mkdir()
    short = measure_looks(tmp_path / "short", 1, DRAW, lambda words: None)
    assert (short.seen, short.felled_found) == (found.seen, found.felled_found)
    assert short.samples == found.samples[:1]


def test_a_resumed_run_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Raises where it works a task again, or its map is another one."""
    monkeypatch.setattr("ltm_ros.archive.publish.write_page", lambda map_, folder: None)
    small_site = write_small_site(tmp_path)
    options = ArchiveOptions((small_site.bag,), small_site.path, "")
    found = resumed(options, tmp_path / "out", lambda words: None)
    assert found.tasks == 2 * FRAMES
    assert min(found.whole_cpu_s, found.remade_cpu_s) > 0


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


def test_the_engine_s_share_leaves_out_what_warms_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of eight tasks of which each takes 2 s in a worker, and the first two more; the engine 0.1 s each, the first 5.
    Clocks are set, not read."""
    small_site = write_small_site(tmp_path)
    days = write_days(small_site.bag, tmp_path / "days", 4)
    planned = look_through(ArchiveOptions((days,), small_site.path, str(tmp_path / "out")), lambda done, total: None)
    wall, engine = (iter(5.0 + step * np.arange(8)) for step in (0.5, 0.1))
    monkeypatch.setattr("ltm_lab.bench.archive_speedup.time.perf_counter", lambda: next(wall))
    monkeypatch.setattr("ltm_lab.bench.archive_speedup.time.process_time", lambda: next(engine))

    def timed(tasks: Sequence[Task], settings: TaskSettings) -> Iterator[Done]:
        for number, task in enumerate(tasks):
            yield Done(task, TimedReport(FRAMES, 2.0 if number >= 2 else 70.0))

    found = WorkedPlan(planned, timed)
    share = found.share(2)
    assert (share.tasks, share.frames, share.tasks_s) == (6, FRAMES, 12.0)
    assert share.engine_s == pytest.approx(0.6)
    assert share.share == pytest.approx(0.6 / 12.6)
    # Of five tasks between the second and the seventh, the last one left out.
    assert found.rate(2, 1) == pytest.approx(5 * FRAMES / 2.5)


@pytest.mark.slow
def test_two_processes_are_measured_against_one(tmp_path: Path) -> None:
    small_site = write_small_site(tmp_path)
    found = measure_speedup(small_site.bag, small_site.path, tmp_path, 6, lambda words: None)
    assert (found.tasks, found.frames, found.share.tasks) == (12, FRAMES, 12 - 4)
    assert found.times > 0
    assert 0 < found.share.share < 1


@pytest.mark.slow
def test_what_a_worker_and_the_engine_cost(tmp_path: Path) -> None:
    small_site = write_small_site(tmp_path)
    planned = look_through(
        ArchiveOptions((small_site.bag,), small_site.path, str(tmp_path / "out")), lambda done, total: None
    )
    found = worker_cost(planned.tasks, planned.settings)
    assert found.to_votes_s > 0
    assert len(list((tmp_path / "out/evidence").iterdir())) == len(planned.tasks) == 2
    assert sum(len(task.frames) for task in planned.tasks) == 2 * FRAMES
    assert found.to_measured_s is None
    again = look_through(
        ArchiveOptions((small_site.bag,), small_site.path, str(tmp_path / "shared"), frames_per_task=2),
        lambda done, total: None,
    )
    share = engine_share(again.tasks, again.settings)
    assert (share.tasks, share.frames) == (2 * FRAMES // 2 - 1, 2)
    assert share.each_ms > 0
    assert 0 < share.share < 1
    spent = engine_cost(40, replace(planned.settings, code="another"))
    assert (spent.tasks, spent.each_ms > 0) == (40, True)


@pytest.mark.slow
def test_whatever_is_killed_the_map_is_the_same(tmp_path: Path) -> None:
    """Twice, a worker or the whole command with its scheduler; results that were taken away are worked again."""
    small_site = write_small_site(tmp_path)
    serially = ArchiveOptions((small_site.bag,), small_site.path, str(tmp_path / "serial"), frames_per_task=1)

    def reprocessed(options: ArchiveOptions) -> str:
        return run(look_through(options, lambda done, total: None), serial, lambda done, total: None).digest

    out = tmp_path / "killed"
    workers, commands = run_under_kills(small_site.bag, small_site.path, out, 2, random.Random(3))
    assert workers + commands == 2
    assert reprocessed(replace(serially, out=str(out))) == reprocessed(serially)
