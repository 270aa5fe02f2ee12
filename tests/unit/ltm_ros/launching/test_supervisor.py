import signal
import sys
from collections.abc import Callable
from pathlib import Path

from scenes.waiting import wait_for

from ltm_ros.launching.supervisor import NodeProcess, RestartPolicy

QUICK = RestartPolicy(initial_s=0.01, maximum_s=0.02, config_tries=2)


class Supervised:
    def __init__(self, program: str, policy: RestartPolicy = QUICK) -> None:
        self.lines: list[str] = []
        self.ends = 0
        self.process = NodeProcess(
            label="north/depth",
            command=[sys.executable, "-u", "-c", program],
            environment={"PATH": "/usr/bin:/bin", "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"},
            console=self.lines.append,
            policy=policy,
            on_end=self._ended,
        )
        self.process.start()

    def _ended(self) -> None:
        self.ends += 1

    def wait_for(self, condition: Callable[[], object]) -> None:
        wait_for(condition, "the process", lambda: self.lines)

    def end(self) -> None:
        self.process.request_stop()
        while not self.process.wait_stopped(0.1):  # it may be starting
            self.process.signal(signal.SIGKILL, whole_group=True)


def test_restarts_whatever_way_it_dies() -> None:
    one = Supervised("import os; print('up'); os.abort()")
    one.wait_for(lambda: one.process.starts >= 3)
    one.end()
    assert one.process.starts >= 3
    assert "[north/depth] -- killed by SIGABRT after " in "\n".join(one.lines)
    assert one.ends == one.process.starts


def test_waits_longer_after_each_death_but_not_after_a_long_run() -> None:
    for healthy_s, pauses in ((20.0, ["0.1", "0.2", "0.3"]), (0.0, ["0.1", "0.1", "0.1"])):
        one = Supervised("raise SystemExit(1)", RestartPolicy(initial_s=0.1, maximum_s=0.3, healthy_s=healthy_s))
        one.wait_for(lambda one=one: one.process.starts >= 4)  # type: ignore[misc]
        one.end()
        assert [line.split()[-2] for line in one.lines if "restarting in" in line][:3] == pauses


def test_is_started_again_after_a_configuration_error_that_passes(tmp_path: Path) -> None:
    """Such as a disk that is mounted late."""
    program = f"import os, sys, time; os.path.exists({str(tmp_path / 'disk')!r}) or sys.exit(78); print('a disk')"
    one = Supervised(f"print('no disk'); {program}; time.sleep(600)")
    one.wait_for(lambda: one.process.failing)
    assert one.process.config_errors >= 2
    assert one.process.last_words[-1] == "no disk"
    (tmp_path / "disk").touch()
    one.wait_for(lambda: one.process.last_words[-1] == "a disk")
    one.process.signal(signal.SIGKILL)
    one.wait_for(lambda: one.process.last_exit == "killed by SIGKILL")
    assert not one.process.failing
    one.end()


def test_ends_what_the_process_had_started() -> None:
    program = (
        "import subprocess, sys; c = subprocess.Popen([sys.executable, '-S', '-c', 'import time; time.sleep(600)']);"
        "print(c.pid); sys.exit(1)"
    )
    one = Supervised(program)
    one.wait_for(lambda: one.process.starts >= 2)
    one.end()
    pids = [int(line.split()[-1]) for line in one.lines if line.split()[-1].isdigit()]
    assert pids
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
