from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import BinaryIO

import numpy as np

from ltm_core.base.errors import PoseError
from ltm_core.pipeline.fusing_step import MeasuredFrame
from ltm_ros.archive.frame_files import LostFrame, MeasuredFile
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.plan import Task
from ltm_ros.archive.reduction import measured_frames

SECOND = 10**9


def frame(camera: str, second: int, logged_after: int = 0) -> ArchiveFrame:
    stamp = second * SECOND
    return ArchiveFrame(camera, stamp, "bag", "image", stamp + logged_after, 1, "content", (), (), (), ())


def measured(second: int, trouble: str = "") -> MeasuredFrame:
    depth = np.full((2, 3), second, np.float32)
    depth[0, 1] = np.nan
    return MeasuredFrame(depth, depth / np.float32(10), np.full((4, 5), second, np.uint8), trouble)


class Files:
    """Of tasks, by their names, and how many were open at once."""

    def __init__(self) -> None:
        self.files: dict[str, MeasuredFile] = {}
        self._open = self.most_open = 0

    def task(self, *frames: ArchiveFrame) -> Task:
        name = f"{frames[0].camera} {frames[0].stamp_ns}"
        self.files[name] = MeasuredFile()
        for one in frames:
            self.files[name].take(one, measured(one.stamp_ns // SECOND))
        return Task(frames, "steps", "votes", "evidence", measured_key=name)

    @contextmanager
    def open(self, task: Task) -> Iterator[BinaryIO]:
        self._open += 1
        self.most_open = max(self.most_open, self._open)
        yield io.BytesIO(self.files[task.measured_key].content({"camera": task.frames[0].camera}))
        self._open -= 1


def test_frames_come_by_stamps_and_of_each_camera_one_file_is_open() -> None:
    files = Files()
    of_mast = [files.task(*(frame("mast", 10 * k + j) for j in (1, 4))) for k in range(6)]
    of_tower = [files.task(frame("tower", 10 * k + 2), frame("tower", 10 * k + 8)) for k in range(5)]
    found = list(measured_frames([*of_mast, *of_tower], files.open, []))
    stamps = [one.stamp_ns for one, _ in found]
    assert stamps == sorted(stamps)
    assert len(stamps) == 22
    assert files.most_open == 2
    for one, content in found:
        expected = measured(one.stamp_ns // SECOND)
        np.testing.assert_array_equal(content.depth, expected.depth)
        np.testing.assert_array_equal(content.sigma, expected.sigma)
        np.testing.assert_array_equal(content.labels, expected.labels)


def test_frames_without_a_measurement_are_named() -> None:
    """One that could not be worked, and one of which the network gave nothing, which the terrain takes all the same."""
    files, lost = Files(), list[LostFrame]()
    task = files.task(frame("mast", 1))
    unworked, unmeasured = frame("mast", 2), frame("mast", 3)
    files.files[task.measured_key].lose(unworked, PoseError("below the ground"))
    files.files[task.measured_key].take(unmeasured, measured(3, "depth of the wrong shape"))
    whole = Task((*task.frames, unworked, unmeasured), "steps", "votes", "evidence", measured_key=task.measured_key)
    assert [one.stamp_ns // SECOND for one, _ in measured_frames([whole], files.open, lost)] == [1, 3]
    assert [(one.stamp_ns // SECOND, one.cause) for one in lost] == [(2, "pose"), (3, "network")]
    assert lost[1].why == "depth of the wrong shape (bag, stamp 3000000000 ns)"
