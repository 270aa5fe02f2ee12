import threading
from collections.abc import Callable
from typing import Any, cast

import pytest
from scenes.waiting import wait_for

from ltm_ros.recordings import bounded_recording as recording_thread
from ltm_ros.recordings.bounded_recording import BoundedRecording, RecordingThread
from ltm_ros.runtime.health import Health


class Disk:
    """A recording whose disk waits until it is told to go on."""

    def __init__(self) -> None:
        self.goes, self.at_work = threading.Event(), threading.Event()
        self.written: list[tuple[str, bytes, int]] = []
        self.flushed = 0

    def add_topic(self, *_: Any) -> None:
        self._wait()

    def write(self, topic: str, _: str, cdr: bytes, log_time_ns: int) -> None:
        self._wait()
        self.written.append((topic, cdr, log_time_ns))

    def flush(self) -> None:
        self._wait()
        self.flushed += 1

    def close(self) -> bool:
        return True

    def _wait(self) -> None:
        self.at_work.set()
        assert self.goes.wait(60.0)


@pytest.fixture
def recorder(monkeypatch: pytest.MonkeyPatch) -> Callable[[int, int], tuple[RecordingThread, Disk, Health]]:
    """Of a recorder that may hold so many bytes and messages, whose disk has just begun to wait."""

    def made(most_bytes: int, most_messages: int) -> tuple[RecordingThread, Disk, Health]:
        monkeypatch.setattr(recording_thread, "QUEUE_BYTES", most_bytes)
        monkeypatch.setattr(recording_thread, "QUEUE_MESSAGES", most_messages)
        disk, health = Disk(), Health()
        thread = RecordingThread(cast(BoundedRecording, disk), health, pytest.fail)
        thread.add_topic("/ridge/info", "std_msgs/msg/String", False)
        assert disk.at_work.wait(60.0)
        return thread, disk, health

    return made


@pytest.mark.parametrize(
    ("most_bytes", "most_messages", "size", "kept"),
    [(1 << 20, 40, 3, 40), (1000, 40, 300, 3), (1000, 40, 0, 40)],
    ids=["many tiny", "few large", "empty"],
)
def test_what_is_over_either_bound_is_dropped_and_counted(
    recorder: Any, most_bytes: int, most_messages: int, size: int, kept: int
) -> None:
    thread, disk, health = recorder(most_bytes, most_messages)
    for i in range(50):
        thread.take("/ridge/info", "std_msgs/msg/String", bytes([i]) * size, i)
    assert health.dropped == {"overload": 50 - kept}
    assert f"{kept} messages (0 MB) are queued for the disk" in health.last_error
    disk.goes.set()
    wait_for(lambda: len(disk.written) == kept, "what waited on the disk")
    wait_for(lambda: health.summary().get("queue_messages") == "0", "room again")
    thread.take("/ridge/info", "std_msgs/msg/String", b"later", 99)
    assert thread.close()
    assert disk.written == [
        *(("/ridge/info", bytes([i]) * size, i) for i in range(kept)),
        ("/ridge/info", b"later", 99),
    ]
    assert health.dropped == {"overload": 50 - kept}


def test_what_still_waits_at_the_end_is_given_up_and_counted(recorder: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording_thread, "CLOSE_S", -1.0)
    thread, disk, health = recorder(1000, 40)
    for i in range(3):
        thread.take("/ridge/info", "std_msgs/msg/String", b"waits", i)
    threading.Timer(0.2, disk.goes.set).start()
    assert thread.close()
    assert disk.written == []
    assert health.dropped == {"stopped": 3}
