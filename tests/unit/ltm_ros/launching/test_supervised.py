import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from scenes.waiting import wait_for

from ltm_core.site.sections import WatchdogConfig
from ltm_ros.launching.supervised import start_supervised, supervised_command
from ltm_ros.launching.supervisor import NodeProcess, RestartPolicy

MODULE = """
import ctypes, os, signal, sys, threading, time
from ltm_ros.runtime.heartbeat import HEARTBEAT, STARTING

def end(*_):
    print("ended in order", flush=True)
    sys.exit(0)

signal.signal(signal.SIGTERM, end)
print(sys.argv[1], os.getpid(), flush=True)
worker = HEARTBEAT.activity("worker")
STARTING.end()
well_now = os.path.exists(sys.argv[2])
open(sys.argv[2], "w").close()
if sys.argv[1] == "holds_the_lock" and not well_now:
    libc, mutex = ctypes.PyDLL(None), ctypes.create_string_buffer(64)
    libc.pthread_mutex_lock(mutex)
    libc.pthread_mutex_lock(mutex)  # for ever, and no signal interrupts it
if sys.argv[1] == "stands_still" and not well_now:
    worker.begin("Image")
while True:
    time.sleep(0.1)
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """On the path of processes, with the module `actor` in it."""
    (tmp_path / "actor.py").write_text(MODULE)
    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", ""), str(Path.cwd())])
    )
    return tmp_path


class Watched:
    def __init__(self, folder: Path, behaviour: str) -> None:
        self.lines: list[str] = []
        self.process = NodeProcess(
            label="north/depth",
            command=supervised_command("actor", behaviour, str(folder / f"{behaviour}_once")),
            environment=os.environ,
            console=self.lines.append,
            policy=RestartPolicy(initial_s=0.01, maximum_s=0.02),
            # `stuck` also bounds how long a new one may take to its first sign of life, which a busy machine delays.
            watchdog=WatchdogConfig(silent=4.0, stuck=8.0, slow=60.0),
        )
        self.process.start()

    def wait_for(self, text: str, times: int = 1) -> None:
        wait_for(lambda: sum(text in line for line in self.lines) >= times, text, lambda: "\n".join(self.lines))


@pytest.fixture
def watched(folder: Path) -> Iterator[list[Watched]]:
    started: list[Watched] = []
    yield started
    for one in started:
        one.process.request_stop()
        one.process.signal(signal.SIGKILL, whole_group=True)
        assert one.process.wait_stopped(10.0)


def test_what_hangs_is_killed_and_started_again_with_its_reason(folder: Path, watched: list[Watched]) -> None:
    for behaviour in ("stopped", "stands_still", "holds_the_lock", "well"):
        watched.append(Watched(folder, behaviour))
        watched[-1].wait_for(behaviour)
    stopped, standing, locked, well = watched
    first = stopped.process.pid
    stopped.process.signal(signal.SIGSTOP)
    for one, reason in (
        (stopped, "it is stopped (SIGSTOP); killed (hang 1)"),
        (standing, "-- hung: worker: Image has not finished in "),
        (locked, "-- hung: no heartbeat for "),
    ):
        one.wait_for(reason)
        one.wait_for("restarting")
        wait_for(lambda one=one: one.process.starts == 2, "another start")  # type: ignore[misc]
        assert one.process.hangs == 1
        assert one.process.last_exit.startswith("hung (")
    assert stopped.process.pid != first
    # Where it hung is in its output.
    for one in (standing, locked):
        one.wait_for('actor.py", line')
    assert (well.process.starts, well.process.hangs) == (1, 0)
    for one, behaviour in ((standing, "stands_still"), (locked, "holds_the_lock")):
        one.wait_for(behaviour, times=2)
        assert one.process.hangs == 1, "no stale state: the new one is well"


LAST_WORDS = """
import atexit, os, sys, threading, time

class Kept:
    def __del__(self, write=os.write):
        write(1, b"taken apart\\n")

threading.kept = Kept()
atexit.register(print, "what was asked for at the end")
threading.Thread(target=lambda: (time.sleep(0.2), print("a thread's end"))).start()
print("the module's end")
{end}
"""


@pytest.mark.parametrize(
    ("end", "status", "apart"),
    [
        ("", 0, False),
        ("sys.exit(74)", 74, False),
        ("raise ValueError('wrong')", 1, True),
    ],
)
def test_a_process_does_what_it_still_has_to_do_and_is_not_taken_apart(
    folder: Path, end: str, status: int, apart: bool
) -> None:
    """One that fails ends as any other of Python."""
    (folder / "actor.py").write_text(LAST_WORDS.format(end=end))
    process, heard = start_supervised(supervised_command("actor"), dict(os.environ))
    said, _ = process.communicate(timeout=60)
    os.close(heard)
    assert process.returncode == status
    words = ["the module's end", "a thread's end", "what was asked for at the end", *(["taken apart"] if apart else [])]
    assert [line for line in said.splitlines() if line in {*words, "taken apart"}] == words
    assert ("wrong" in said) == apart
