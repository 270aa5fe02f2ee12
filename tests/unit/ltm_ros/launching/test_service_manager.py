"""What a service manager hears: sd_notify(3), on a real socket; and the status of a run."""

from __future__ import annotations

import os
import sys
import threading
import uuid
from pathlib import Path

import pytest
from scenes.notify_socket import NotifySocket
from scenes.waiting import wait_for

from ltm_core.base.errors import ConfigError
from ltm_ros.launching import supervisor
from ltm_ros.launching.service_manager import LONGEST, ServiceManager, all_watched, in_words
from ltm_ros.launching.supervisor import NodeProcess, ProcessState, RestartPolicy


def test_the_manager_hears_ready_once_signs_of_life_and_the_end(tmp_path: Path) -> None:
    with NotifySocket(tmp_path / "notify") as socket:
        environ = {"NOTIFY_SOCKET": socket.address, "WATCHDOG_USEC": "30", "WATCHDOG_PID": str(os.getpid()), "A": "b"}
        manager = ServiceManager.of_environment(environ)
        assert environ == {"A": "b"}, "no child may speak for this process"
        manager.starting("starting 3 nodes")
        manager.starting("starting 3 nodes")
        assert not manager.is_ready
        manager.ready("all 2 processes run")
        manager.ready("all 2 processes run")
        manager.alive("1 of 2 processes run;\ndown: depth")
        manager.stopping()
        manager.stopping()
        manager.alive("too late")
        manager.close()
        assert socket.heard[:4] == [
            ("STATUS", "starting 3 nodes"),
            ("EXTEND_TIMEOUT_USEC", "120000000"),
            ("READY", "1"),
            ("STATUS", "all 2 processes run"),
        ]
        assert socket.of("READY") == socket.of("STOPPING") == ["1"]
        assert socket.of("STATUS")[2:] == ["1 of 2 processes run; down: depth", "stopping"]
        assert socket.of("WATCHDOG")


def test_the_abstract_namespace_is_reached() -> None:
    with NotifySocket(f"@ltm-{uuid.uuid4()}") as socket:
        ServiceManager(socket.address).ready("up")
        assert socket.heard == [("READY", "1"), ("STATUS", "up")]


@pytest.mark.parametrize("pid", ["1", "999999999"])
def test_a_watchdog_meant_for_another_process_hears_nothing_from_this_one(tmp_path: Path, pid: str) -> None:
    with NotifySocket(tmp_path / "notify") as socket:
        environ = {"NOTIFY_SOCKET": socket.address, "WATCHDOG_USEC": "30", "WATCHDOG_PID": pid}
        ServiceManager.of_environment(environ).alive("up")
        assert socket.heard == [("STATUS", "up")]


def test_signs_of_life_come_no_more_often_than_wanted(tmp_path: Path) -> None:
    with NotifySocket(tmp_path / "notify") as socket:
        manager = ServiceManager(socket.address, watchdog_s=3600.0)
        for _ in range(5):
            manager.alive("up")
        assert len(socket.of("WATCHDOG")) == 1


def test_without_a_manager_nothing_is_sent_and_nothing_is_wrong() -> None:
    manager = ServiceManager.of_environment({"WATCHDOG_USEC": "30"})
    manager.starting("a")
    manager.ready("b")
    manager.stopping()


def test_a_manager_that_goes_away_stops_nothing(tmp_path: Path) -> None:
    with NotifySocket(tmp_path / "notify") as socket:
        manager = ServiceManager(socket.address, watchdog_s=1e-6)
    manager.alive("up")
    manager.ready("up")


@pytest.mark.parametrize(
    ("environ", "said"),
    [
        ({}, "NOTIFY_SOCKET is not set"),
        ({"NOTIFY_SOCKET": "vsock:2:1"}, "expected a path or @name"),
        ({"NOTIFY_SOCKET": "/nowhere/notify"}, "no service manager listens"),
        ({"NOTIFY_SOCKET": "@x", "WATCHDOG_USEC": "-3"}, "WATCHDOG_USEC='-3': expected a number"),
    ],
)
def test_an_environment_that_makes_no_sense_is_refused(environ: dict[str, str], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        ServiceManager.of_environment(environ, required=True)


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
