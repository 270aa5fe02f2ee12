"""One supervised process, without ROS: its output and its log, its deaths, its end."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from scenes.waiting import wait_for

from ltm_ros.launching import node_log
from ltm_ros.launching.node_log import NodeLog
from ltm_ros.launching.supervisor import NodeProcess, ProcessState, RestartDelay, RestartPolicy, describe_exit
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


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (-9, "killed by SIGKILL"),
        (-11, "killed by SIGSEGV"),
        (-63, "killed by signal 63"),
        (0, "ended normally (exit code 0)"),
        (3, "exit code 3"),
        (78, "exit code 78: its configuration is invalid"),
    ],
)
def test_says_how_a_process_ended(status: int, words: str) -> None:
    assert describe_exit(status) == words


class Supervised:
    def __init__(self, folder: Path, program: str, policy: RestartPolicy = QUICK) -> None:
        self.lines: list[str] = []
        self.ends = 0
        self.process = NodeProcess(
            label="north/depth",
            command=[sys.executable, "-u", "-c", program],
            environment={"PATH": "/usr/bin:/bin", "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"},
            log_file=folder / "logs" / "north.depth.log",
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
        self.process.close()


def test_output_of_both_kinds_goes_to_console_and_log(tmp_path: Path) -> None:
    one = Supervised(tmp_path, "import sys, time; print('out'); print('err \\udcff', file=sys.stderr); time.sleep(60)")
    one.wait_for(lambda: len(one.lines) == 2)
    one.end()
    assert one.lines[0] == "[north/depth] out"
    assert one.lines[1].startswith("[north/depth] err")
    log = (tmp_path / "logs/north.depth.log").read_text().splitlines()
    assert [line.split(" ", 2)[2][:3] for line in log] == ["-- ", "out", "err"]
    assert one.process.state is ProcessState.STOPPED


def test_a_node_that_says_nothing_has_a_log_with_its_start(tmp_path: Path) -> None:
    one = Supervised(tmp_path, "import time; time.sleep(60)")
    log = tmp_path / "logs/north.depth.log"
    one.wait_for(lambda: log.is_file() and log.read_text().endswith("\n"))
    assert log.read_text().strip().endswith(f"-- started as process {one.process.pid}")
    assert not one.lines, "the console is told of nodes that are not as they should be"
    one.end()


def test_restarts_whatever_way_it_dies(tmp_path: Path) -> None:
    one = Supervised(tmp_path, "import os; print('up'); os.abort()")
    one.wait_for(lambda: one.process.starts >= 3)
    one.end()
    assert one.process.restarts >= 2
    assert "[north/depth] -- killed by SIGABRT after " in "\n".join(one.lines)
    assert one.ends == one.process.starts


def test_gives_up_a_configuration_error_with_its_last_words(tmp_path: Path) -> None:
    given_up: list[str] = []
    one = Supervised(tmp_path, "import sys; print('no such camera'); sys.exit(78)")
    one.process.on_given_up = lambda: given_up.append("north/depth")
    one.wait_for(lambda: one.process.state is ProcessState.GIVEN_UP)
    assert one.process.wait_stopped(5.0)
    assert one.process.starts == 2
    assert one.process.last_words()[-1] == "no such camera"
    assert one.lines[-1].endswith("no such camera")
    assert one.process.signal(signal.SIGKILL) is False
    one.process.close()


def test_stops_while_it_waits_to_restart(tmp_path: Path) -> None:
    one = Supervised(tmp_path, "raise SystemExit(1)", RestartPolicy(initial_s=3600.0, maximum_s=3600.0))
    one.wait_for(lambda: any("restarting in 3600.0 s" in line for line in one.lines))
    one.process.request_stop()
    assert one.process.wait_stopped(5.0)


def test_command_that_does_not_exist_is_reported_and_tried_again(tmp_path: Path) -> None:
    one = Supervised(tmp_path, "pass")
    one.end()
    lines: list[str] = []
    process = NodeProcess("x", ["/no/such/python"], {}, tmp_path / "x.log", lines.append, QUICK)
    process.start()
    wait_for(lambda: sum("cannot be started" in line for line in lines) >= 2, "two tries", lambda: lines)
    process.request_stop()
    assert process.wait_stopped(5.0)
    process.close()


def test_ends_what_the_process_had_started(tmp_path: Path) -> None:
    program = (
        "import subprocess, sys; c = subprocess.Popen([sys.executable, '-S', '-c', 'import time; time.sleep(600)']);"
        "print(c.pid); sys.exit(1)"
    )
    one = Supervised(tmp_path, program)
    one.wait_for(lambda: one.process.starts >= 2)
    one.end()
    pids = [int(line.split()[-1]) for line in one.lines if line.split()[-1].isdigit()]
    assert pids
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)


def test_lines_go_to_the_file_with_their_time(tmp_path: Path) -> None:
    log = NodeLog(tmp_path / "made" / "north.depth.log", pytest.fail)
    log.write("begun \udcff")
    log.write("done")
    log.close()
    lines = (tmp_path / "made" / "north.depth.log").read_text().splitlines()
    assert [line[24:] for line in lines] == ["begun ?", "done"]
    assert lines[0][:4].isdigit()


def test_old_files_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node_log, "LOG_BYTES", 300)
    log = NodeLog(tmp_path / "a.log", pytest.fail)
    for i in range(100):
        log.write(f"line {i}")
    log.close()
    names = ["a.log.2", "a.log.1", "a.log"]
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names)
    assert all((tmp_path / name).stat().st_size <= 300 for name in names)
    lines = [line for name in names for line in (tmp_path / name).read_text().splitlines()]
    assert [line.partition(" line ")[2] for line in lines] == [str(i) for i in range(100 - len(lines), 100)]
    assert len(lines) > 15


def test_a_disk_that_takes_nothing_is_told_of_once(tmp_path: Path) -> None:
    told: list[str] = []
    path = tmp_path / "a.log"
    path.symlink_to("/dev/full")
    log = NodeLog(path, told.append)
    for i in range(50):
        log.write(f"line {i}")
    assert told == [f"{path} cannot be written (No space left on device); free some disk space"]
    log.close()
    path.unlink()
    log.write("after")
    log.write("later")
    log.close()
    assert told[1:] == [f"{path} can be written again; 50 lines were lost"]
    assert [line[24:] for line in path.read_text().splitlines()] == ["after", "later"]


def test_a_folder_that_cannot_be_made_is_told_of_too(tmp_path: Path) -> None:
    told: list[str] = []
    (tmp_path / "file").write_text("in the way")
    NodeLog(tmp_path / "file" / "a.log", told.append).write("x")
    assert len(told) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
