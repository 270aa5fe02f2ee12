from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from scenes.s3_bucket import empty_bucket
from scenes.small_site import FRAMES, SmallSite
from scenes.waiting import wait_for

from ltm_core.base.errors import ArchiveError
from ltm_core.pipeline.stored_fuel import STORE_FILE, STORE_KIND
from ltm_core.storage.tile_store import TileStore
from ltm_ros.archive.engine import Cluster, Engine, on_cluster, on_workers, serial
from ltm_ros.archive.plan import Task, TaskSettings
from ltm_ros.archive.reduction import store_digest
from ltm_ros.archive.results import ResultFolder
from ltm_ros.archive.run import ArchiveOptions, Summary, look_through, run
from ltm_ros.archive.task import TaskReport


def reprocessed(options: ArchiveOptions, engine: Engine = serial) -> Summary:
    return run(look_through(options, lambda done, total: None), engine, lambda done, total: None)


@pytest.fixture
def bucket() -> Iterator[str]:
    with empty_bucket("archive") as address:
        yield f"{address}/year"


def test_results_on_s3_are_those_on_disk(small_site: SmallSite, bucket: str, expected: str, tmp_path: Path) -> None:
    options = ArchiveOptions((small_site.bag,), small_site.path, bucket, frames_per_task=3)
    summary = reprocessed(options)
    assert (summary.digest, summary.worked) == (expected, 2 * FRAMES)
    results = ResultFolder(bucket)
    (tmp_path / STORE_FILE).write_bytes(results.read(STORE_FILE))
    with TileStore.open_read_only(tmp_path / STORE_FILE, STORE_KIND) as store:
        assert store_digest(store) == expected
    assert "item.stac.json" in results.names("layers")
    again = reprocessed(options)
    assert (again.digest, again.worked) == (expected, 0)
    results.write(STORE_FILE, b"a node went on")
    with pytest.raises(ArchiveError, match="a node may have continued from it"):
        reprocessed(options)


def test_a_store_that_keeps_refusing_is_named_and_the_run_goes_on_later(
    small_site: SmallSite, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    monkeypatch.setattr("s3fs.S3FileSystem.retries", 1)
    closed = list[bool]()

    def refuses(request: str) -> bool:
        return bool(closed) and request.startswith("PUT") and "/votes/" in request

    with empty_bucket("refusing", refuses) as address:
        options = ArchiveOptions((small_site.bag,), small_site.path, f"{address}/year", frames_per_task=3)
        closed.append(True)
        with pytest.raises(ArchiveError, match=r"12 of 12 frames failed \(12 task\)"):
            reprocessed(options)
        record = json.loads(ResultFolder(options.out).read("run.json"))
        assert all("cannot be used now" in failure["why"] for failure in record["failures"])
        closed.clear()
        assert reprocessed(options).digest == expected


def certificates(folder: Path) -> dict[str, Path]:
    """An authority, and a certificate of it that scheduler, workers and client share."""
    files = {name: folder / f"{name}.pem" for name in ("ca", "ca_key", "certificate", "key")}
    curve = "-x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2"
    for words in (
        f"-keyout {files['ca_key']} -out {files['ca']} -subj /CN=authority",
        f"-keyout {files['key']} -out {files['certificate']} -subj /CN=ours -CA {files['ca']} "
        f"-CAkey {files['ca_key']} -addext subjectAltName=IP:127.0.0.1",
    ):
        subprocess.run(["openssl", "req", *curve.split(), *words.split()], check=True, capture_output=True)
    return files


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """A scheduler and a worker, programs of their own, over mutual TLS."""
    if shutil.which("openssl") is None:
        pytest.skip("needs openssl, for certificates")
    files = certificates(tmp_path)
    given = ["--tls-ca-file", files["ca"], "--tls-cert", files["certificate"], "--tls-key", files["key"]]
    told, log = tmp_path / "scheduler.json", (tmp_path / "cluster.log").open("wb")
    dask = [sys.executable, "-m", "dask"]
    processes = []

    def start(*words: object) -> None:
        command = [*dask, *map(str, words), *map(str, given)]
        processes.append(subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True))

    try:
        place = ("--host", "tls://127.0.0.1", "--port", "0", "--no-dashboard", "--no-show")
        start("scheduler", *place, "--scheduler-file", told)
        wait_for(told.exists, "the scheduler")
        address = str(json.loads(told.read_text())["address"])
        start("worker", address, "--nthreads", "1", "--no-dashboard", "--local-directory", tmp_path, "--no-nanny")
        yield Cluster(address, files["ca"], files["certificate"], files["key"])
    finally:
        for process in processes:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        log.close()


@pytest.mark.slow
def test_a_cluster_over_tls_gives_the_same_and_strangers_are_refused(
    small_site: SmallSite, cluster: Cluster, expected: str, tmp_path: Path
) -> None:
    options = ArchiveOptions((small_site.bag,), small_site.path, str(tmp_path / "out"), frames_per_task=2)
    assert reprocessed(options, on_cluster(cluster)).digest == expected
    (tmp_path / "other").mkdir()
    other = certificates(tmp_path / "other")
    stranger = Cluster(cluster.address, other["ca"], other["certificate"], other["key"])
    with pytest.raises(ArchiveError, match="no scheduler responds"):
        reprocessed(ArchiveOptions((small_site.bag,), small_site.path, str(tmp_path / "none")), on_cluster(stranger))


@pytest.mark.slow
def test_a_task_that_kills_its_workers_is_named_and_the_others_end(
    small_site: SmallSite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a decoder's fault does, or too little memory."""
    options = ArchiveOptions((small_site.bag,), small_site.path, str(tmp_path / "out"), frames_per_task=3)
    deadly = look_through(options, lambda done, total: None).tasks[0]

    def work(task: Task, settings: TaskSettings) -> TaskReport:
        import os

        from ltm_ros.archive.task import work

        return os._exit(9) if task.evidence_key == deadly.evidence_key else work(task, settings)

    with monkeypatch.context() as patched:
        patched.setattr("ltm_ros.archive.engine.work", work)
        with pytest.raises(ArchiveError, match=r"3 of 12 frames failed \(3 task\)"):
            reprocessed(options, on_workers(2))
    record = json.loads((tmp_path / "out/run.json").read_text())
    assert [failure["place"] for failure in record["failures"]] == [deadly.label]
    assert "several workers died of it" in record["failures"][0]["why"]
    assert reprocessed(options).worked == 3
