"""Run tasks: one after the other, on processes of this machine, or on a Dask cluster.

All give the same files; the worker, time and number of attempts of a task have no effect.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from ltm_core.base.errors import ArchiveError, LtmError
from ltm_core.base.redaction import is_loopback
from ltm_ros.archive.plan import Task, TaskSettings
from ltm_ros.archive.task import TaskReport, work
from ltm_ros.runtime.ros_environment import available_cores

_DEATHS = 3
"""Number of workers, beyond the first, that may die during a task before it is given up."""
_LOCAL = {
    "distributed.scheduler.allowed-failures": _DEATHS,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.worker.profile.enabled": False,
    "distributed.nanny.pre-spawn-environ": {"OMP_NUM_THREADS": 1, "OPENBLAS_NUM_THREADS": 1, "MKL_NUM_THREADS": 1},
}
"""Dask settings for this machine: its servers would monitor themselves 50 times per second, and profile workers 100
times, for an unused dashboard. Its environment for workers would also make them return memory at 64 kB, so that each
array of a frame is mapped again: 25 % more processor time.
"""
PATIENCE_S = 30.0
"""Seconds without a finished task after which a cluster without workers is reported, repeatedly."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Cluster:
    """`address`: of a Dask scheduler, `tls://host:port`. `ca`, `certificate`, `key`: PEM files; all certificates are
    checked against `ca`.
    """

    address: str
    ca: Path | None = None
    certificate: Path | None = None
    key: Path | None = None

    def __post_init__(self) -> None:
        place = urlsplit(self.address)
        if place.scheme == "tls":
            if not (self.ca and self.certificate and self.key):
                raise ArchiveError(f"{self.address}: give --tls CA CERT KEY, PEM files")
        elif place.scheme != "tcp" or not is_loopback(place.hostname or ""):
            raise ArchiveError(
                f"{self.address}: a scheduler executes any code it is sent, so other hosts must use tls://"
            )


@dataclass(frozen=True)
class Done:
    """A finished task; `error`: why it gave no result."""

    task: Task
    report: TaskReport | None
    error: str = ""


Job = Callable[[Task, TaskSettings], TaskReport]
Engine = Callable[[Sequence[Task], TaskSettings], Iterator[Done]]


def serial(tasks: Sequence[Task], settings: TaskSettings) -> Iterator[Done]:
    """Run one task after the other in this process."""
    for task in tasks:
        try:
            yield Done(task, work(task, settings))
        except (LtmError, OSError) as error:
            yield Done(task, None, str(error))


def on_workers(count: int, job: Job | None = None) -> Engine:
    """Return an engine with the given number of processes on this machine, which end with it. `job`: replaces the work
    of each task.
    """

    def run(tasks: Sequence[Task], settings: TaskSettings) -> Iterator[Done]:
        import dask
        from distributed import Client, LocalCluster
        from distributed.scheduler import DEFAULT_EXTENSIONS

        # Spans keep a record of each submission for as long as the scheduler runs.
        extensions = {name: part for name, part in DEFAULT_EXTENSIONS.items() if name != "spans"}
        place: dict[str, object] = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}
        with (
            dask.config.set(_LOCAL),
            LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                memory_limit=0,
                silence_logs=logging.ERROR,
                scheduler_kwargs={"extensions": extensions},
                extensions={},
                **place,
            ) as cluster,
            Client(cluster) as client,
        ):
            yield from _windowed(client, tasks, settings, partial(_on_its_cores, count, job or work))

    return run


def _on_its_cores(workers: int, job: Job, task: Task, settings: TaskSettings) -> TaskReport:
    keep_to_cores(workers)
    return job(task, settings)


def keep_to_cores(workers: int) -> None:
    """Limit a worker of this machine to its own core, so that kernels do not wait for another worker's. Not by the
    environment, which Dask also sets in this process while it starts workers, so that numba would find it changed.
    """
    from ltm_core.base.kernels import limit_kernel_threads

    limit_kernel_threads(max(1, available_cores() // workers))


def on_cluster(cluster: Cluster) -> Engine:
    """Return an engine of a running scheduler and its workers."""

    def run(tasks: Sequence[Task], settings: TaskSettings) -> Iterator[Done]:
        from distributed import Client
        from distributed.security import Security

        security = None
        if cluster.address.startswith("tls:"):
            files = {"tls_ca_file": cluster.ca, "tls_client_cert": cluster.certificate, "tls_client_key": cluster.key}
            security = Security(require_encryption=True, **{name: str(file) for name, file in files.items()})
        try:
            client = Client(cluster.address, security=security, timeout="20s")
        except (OSError, TimeoutError) as error:
            raise ArchiveError(
                f"{cluster.address}: no scheduler responds ({error}); start `dask scheduler` and `dask worker`, "
                "with certificates of the same authority"
            ) from error
        with client:
            yield from _windowed(client, tasks, settings, work)

    return run


def _windowed(client: Any, tasks: Sequence[Task], settings: TaskSettings, job: Job) -> Iterator[Done]:
    """Submit as many tasks as workers have threads, so that memory is constant and a dead worker points to its one
    task. Tasks take minutes, so no worker waits long.
    """
    from dask.utils import key_split
    from distributed import wait

    ahead, waiting = iter(tasks), dict[Any, Task]()

    def fill() -> None:
        room = max(sum(client.nthreads().values()), 1) - len(waiting)
        for task in islice(ahead, max(room, 0)):
            future = client.submit(job, task, settings, key=f"{task.label} {task.evidence_key}", pure=False)
            waiting[future] = task

    fill()
    while waiting:
        try:
            ended = wait(list(waiting), timeout=PATIENCE_S, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            if not client.nthreads():
                _log.warning(
                    "%s has no workers; waiting for workers: `dask worker %s` with the cluster's certificates",
                    *[client.scheduler.address] * 2,
                )
            fill()
            continue
        for future in ended:
            task = waiting.pop(future)
            error = future.exception() if future.status == "error" else None
            if future.status == "finished":
                yield Done(task, future.result())
            elif error is None or isinstance(error, LtmError | OSError) or type(error).__name__ == "KilledWorker":
                yield Done(task, None, _said(error, future.status))
            else:
                raise error  # an internal error
            future.release()
        key_split.cache_clear()  # it keeps the names of 100,000 tasks, and each is requested while it is here
        fill()


def _said(error: BaseException | None, status: str) -> str:
    if error is None:
        return f"the task is {status}"
    if type(error).__name__ == "KilledWorker":
        return "several workers died of it: out of memory, or an image that crashes the process"
    return str(error)
