import signal
import sys
from collections.abc import Callable
from pathlib import Path

from scenes.waiting import wait_for

from ltm_ros.launching.supervisor import NodeProcess, ProcessState, RestartDelay, RestartPolicy
from ltm_ros.runtime.handler import EX_CONFIG

QUICK = RestartPolicy(initial_s=0.01, maximum_s=0.02, config_tries=2)


def test_waits_longer_after_each_death_up_to_a_limit() -> None:
    delay = RestartDelay(RestartPolicy(initial_s=0.5, maximum_s=10.0, healthy_s=20.0))
    assert [delay.after(1, 0.1) for _ in range(5)] == [0.5, 1.0, 2.0, 4.0, 8.0]
    assert delay.after(-9, 20.0) == 0.5, "a healthy run starts anew"
    assert delay.after(0, 19.9) == 1.0
    for _ in range(2000):
        assert delay.after(1, 0.0) is not None
    assert delay.after(1, 0.0) == 10.0


def test_gives_up_only_after_configuration_errors_in_a_row() -> None:
    delay = RestartDelay(RestartPolicy(initial_s=0.5, config_tries=2))
    assert delay.after(EX_CONFIG, 0.0) is not None
    assert delay.after(1, 0.0) is not None
    assert delay.after(EX_CONFIG, 0.0) is not None
    assert delay.after(EX_CONFIG, 0.0) is None


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
        self.process.signal(signal.SIGKILL, whole_group=True)
        assert self.process.wait_stopped(10.0)


def test_restarts_whatever_way_it_dies() -> None:
    one = Supervised("import os; print('up'); os.abort()")
    one.wait_for(lambda: one.process.starts >= 3)
    one.end()
    assert one.process.starts >= 3
    assert "[north/depth] -- killed by SIGABRT after " in "\n".join(one.lines)
    assert one.ends == one.process.starts


def test_gives_up_a_configuration_error_with_its_last_words() -> None:
    one = Supervised("import sys; print('no such camera'); sys.exit(78)")
    one.wait_for(lambda: one.process.state is ProcessState.GIVEN_UP)
    assert one.process.wait_stopped(5.0)
    assert one.process.starts == 2
    assert one.process.last_words()[-1] == "no such camera"
    assert one.lines[-1].endswith("no such camera")
    assert one.process.signal(signal.SIGKILL) is False


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
