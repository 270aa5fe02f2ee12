"""What workers of an archive do in place of a task; a process of its own must be able to import it."""

import os

from ltm_core.base.kernels import kernel_threads
from ltm_ros.archive.plan import Task, TaskSettings
from ltm_ros.archive.task import work


def deadly_work(deadly: str, task: Task, settings: TaskSettings) -> int:
    return os._exit(9) if task.key == deadly else work(task, settings)


def full_disk_at_3(task: Task, settings: TaskSettings) -> int:
    if task.key == "3":
        raise OSError("the disk is full")
    return 1


def interrupted_at_0(task: Task, settings: TaskSettings) -> int:
    if task.key == "0":
        raise KeyboardInterrupt
    (settings.results / task.key).touch()
    return 1


def thread_count(task: Task, settings: TaskSettings) -> int:
    return kernel_threads()
