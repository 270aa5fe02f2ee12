from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest
from distributed import LocalCluster

from ltm_core.base.errors import ArchiveError
from ltm_core.pipeline.frame_steps import LabellingConfig, TracingConfig
from ltm_ros.archive import engine
from ltm_ros.archive.engine import Cluster, on_cluster
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.plan import Task, TaskSettings
from ltm_ros.archive.results import ResultFolder
from ltm_ros.archive.task import TaskReport


def test_a_file_is_on_disk_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced, sync = list[tuple[bool, int]](), os.fsync

    def watched(file: int) -> None:
        synced.append(((tmp_path / "votes/a.parquet").exists(), os.fstat(file).st_size))
        sync(file)

    monkeypatch.setattr(os, "fsync", watched)
    results = ResultFolder(str(tmp_path))
    results.write("votes/a.parquet", b"content")
    assert synced == [(False, 7)]
    assert results.names("votes") == {"a.parquet"}
    assert results.read("votes/a.parquet") == b"content"


def test_a_store_that_fails_in_whatever_way_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """As that of S3, whose library has errors that are no OSError."""

    class EndpointConnectionError(Exception):
        pass

    def broken(*given: object, **more: object) -> None:
        raise EndpointConnectionError("no route")

    results = ResultFolder("memory://year")
    results.write("a", b"content")
    for function in ("pipe_file", "cat_file", "exists"):
        monkeypatch.setattr(fsspec.get_filesystem_class("memory"), function, broken)
    for use in (lambda: results.write("a", b""), lambda: results.read("a"), lambda: results.names("a")):
        with pytest.raises(ArchiveError, match=r"memory://year cannot be used now \(EndpointConnectionError"):
            use()
    with pytest.raises(ArchiveError, match="cannot be used now"):
        results.has("a")
    with pytest.raises(ArchiveError, match="cannot be used now"), results.open("a"):
        broken()  # a store that serves parts fails as late as when they are read


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
