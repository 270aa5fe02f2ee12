"""What a runner says of its processes, and whether a restart of it would mend anything."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

from scenes.waiting import wait_for

from ltm_ros.launching import supervisor
from ltm_ros.launching.service_manager import LONGEST, all_watched, in_words
from ltm_ros.launching.supervisor import NodeProcess, ProcessState, RestartPolicy

QUICK = RestartPolicy(initial_s=0.05, maximum_s=0.05, config_tries=2)


def process(folder: Path, label: str, program: str, console: supervisor.Console = print) -> NodeProcess:
    command = [sys.executable, "-S", "-c", program]
    return NodeProcess(label, command, {}, folder / f"{label}.log", console, QUICK)


def stop(*processes: NodeProcess) -> None:
    for one in processes:
        one.request_stop()
        one.signal(9)
        assert one.wait_stopped(10)
        one.close()


def test_what_is_down_is_named_with_its_reason_and_is_watched_all_the_same(tmp_path: Path) -> None:
    lives = process(tmp_path, "fuel_map", "import time; time.sleep(600)")
    cannot = process(tmp_path, "depth", "raise SystemExit(78)")
    assert not all_watched([lives]), "nobody follows it yet"
    for one in (lives, cannot):
        one.start()
    try:
        wait_for(lambda: lives.running and cannot.state is ProcessState.GIVEN_UP, "both")
        assert in_words([lives]) == "all 1 processes run"
        said = in_words([lives, cannot])
        assert said == ("1 of 2 processes run; down: depth (given up, exit code 78: its configuration is invalid)")
        assert len(in_words([lives, *[cannot] * 9])) == LONGEST
        assert all_watched([lives, cannot]), "a restart would not mend a configuration"
    finally:
        stop(lives, cannot)
    assert all_watched([lives, cannot])


def test_a_supervisor_that_hangs_is_noticed(tmp_path: Path) -> None:
    """Here on a console that nobody reads."""
    reads = threading.Event()

    def console(line: str) -> None:
        if "exit code 3" in line:
            reads.wait()

    dies = process(tmp_path, "depth", "raise SystemExit(3)", console)
    limit, supervisor.UNWATCHED_S = supervisor.UNWATCHED_S, 0.2
    dies.start()
    try:
        wait_for(lambda: not dies.watched, "the supervisor to be missed")
        reads.set()
        wait_for(lambda: dies.watched, "it to work again")
    finally:
        supervisor.UNWATCHED_S = limit
        stop(dies)
