"""How tasks come to workers, on a cluster within this process."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator

import numba
import pytest
from distributed import LocalCluster

from ltm_core.pipeline.frame_steps import LabellingConfig, TracingConfig
from ltm_ros.archive import engine
from ltm_ros.archive.engine import Cluster, on_cluster, on_workers
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.plan import Task, TaskSettings
from ltm_ros.archive.task import TaskReport
from ltm_ros.runtime.ros_environment import available_cores

SETTINGS = TaskSettings("site.yaml", "out", "code", TracingConfig(), LabellingConfig())


def task(number: int) -> Task:
    frame = ArchiveFrame("east", number, "a.mcap", "/ridge/image", number, 5, "", (), (), (), ())
    return Task((frame,), "", f"{number}", f"{number}")


def empty(task: Task, settings: TaskSettings) -> TaskReport:
    if task.evidence_key == "3":
        raise OSError("the disk is full")
    return TaskReport(1)


@pytest.fixture
def cluster() -> Iterator[LocalCluster]:
    """A scheduler without workers."""
    place = {"host": "127.0.0.1", "dashboard_address": None}
    with LocalCluster(n_workers=0, threads_per_worker=1, processes=False, protocol="tcp", **place) as cluster:
        yield cluster


def test_a_cluster_without_workers_is_told_of_and_goes_on_when_some_come(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(engine, "PATIENCE_S", 0.05)
    monkeypatch.setattr(engine, "work", empty)

    class Waited(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            cluster.scale(1)

    logger = logging.getLogger(engine.__name__)
    logger.addHandler(waited := Waited())
    try:
        done = list(on_cluster(Cluster(cluster.scheduler_address))([task(n) for n in range(6)], SETTINGS))
    finally:
        logger.removeHandler(waited)
    said = next(record.getMessage() for record in caplog.records if record.name == engine.__name__)
    assert f"{cluster.scheduler_address} has no workers" in said
    assert f"dask worker {cluster.scheduler_address}" in said
    assert {one.task.evidence_key for one in done} == set("012345")
    assert {one.task.evidence_key: one.error for one in done if one.error} == {"3": "the disk is full"}


def surroundings(task: Task, settings: TaskSettings) -> TaskReport:
    hurried = [name for name in os.environ if name.startswith("MALLOC_")]
    return TaskReport(numba.get_num_threads() + 1000 * len(hurried))


@pytest.mark.slow  # starts two processes
def test_workers_keep_their_memory_and_leave_each_other_s_cores_alone() -> None:
    threads = max(1, available_cores() // 2)
    done = list(on_workers(2, surroundings)([task(n) for n in range(3)], SETTINGS))
    assert [one.report for one in done] == 3 * [TaskReport(threads)]
    assert numba.get_num_threads() == numba.config.NUMBA_NUM_THREADS
