"""Who works the tasks of an archive."""

import multiprocessing
import time
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
from scenes.archive_jobs import full_disk_at_3, interrupted_at_0, thread_count

from ltm_core.base.kernels import kernel_threads
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pipeline.frame_steps import LabellingConfig, TracingConfig
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.plan import Task, TaskSettings
from ltm_ros.archive.task import on_workers
from ltm_ros.runtime.ros_environment import available_cores

SETTINGS = TaskSettings("site.yaml", Path("out"), "code", TracingConfig(), LabellingConfig())

CAMERA, POSE = Camera.from_fov(6, 4, 60.0), Pose.from_angles((0, 0, 0), 0.0)


def task(number: int) -> Task:
    frame = ArchiveFrame("east", number, "a.mcap", "/ridge/image", number, 5, "", CAMERA, POSE, np.eye(6))
    return Task((frame,), "", f"{number}")


@pytest.mark.slow  # starts processes
def test_errors_of_tasks_are_kept_and_the_others_end() -> None:
    done = list(on_workers(2, full_disk_at_3)([task(n) for n in range(6)], SETTINGS))
    assert {one.task.key for one in done} == set("012345")
    assert {one.task.key: one.error for one in done if one.error} == {"3": "the disk is full"}


@pytest.mark.slow  # starts a process
def test_an_interrupted_run_begins_no_further_task(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        list(on_workers(1, interrupted_at_0)([task(n) for n in range(3)], replace(SETTINGS, results=tmp_path)))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow  # starts processes
def test_a_worker_that_dies_between_two_tasks_is_replaced() -> None:
    done = on_workers(1, thread_count)([task(n) for n in range(3)], SETTINGS)
    first = next(done)
    for worker in multiprocessing.active_children():
        worker.kill()
        worker.join()
    time.sleep(0.5)  # until its pool has seen it; before that, the task itself is tried again
    assert [one.error for one in [first, *done]] == ["", "", ""]


@pytest.mark.slow  # starts two processes
def test_workers_leave_each_other_s_cores_alone() -> None:
    threads = max(1, available_cores() // 2)
    done = list(on_workers(2, thread_count)([task(n) for n in range(3)], SETTINGS))
    assert [one.worked for one in done] == 3 * [threads]
    assert kernel_threads() == numba.config.NUMBA_NUM_THREADS
