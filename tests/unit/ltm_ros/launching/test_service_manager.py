import os
import sys
import threading
from pathlib import Path

from scenes.notify_socket import NotifySocket
from scenes.waiting import wait_for

from ltm_ros.launching import supervisor
from ltm_ros.launching.service_manager import LONGEST, ServiceManager, in_words
from ltm_ros.launching.supervisor import NodeProcess, RestartPolicy


def test_the_manager_hears_ready_once_signs_of_life_and_the_end(tmp_path: Path) -> None:
    with NotifySocket(tmp_path / "notify") as socket:
        environ = {"NOTIFY_SOCKET": socket.address, "WATCHDOG_USEC": "30", "WATCHDOG_PID": str(os.getpid()), "A": "b"}
        manager = ServiceManager.of_environment(environ)
        assert environ == {"A": "b"}, "no child may speak for this process"
        for _ in range(2):
            manager.report("starting 3 nodes", ready=False, alive=True)
        for _ in range(2):
            manager.report("all 2 processes run", ready=True, alive=True)
        manager.report("a supervisor does not respond", ready=True, alive=False)
        seen = len(socket.of("WATCHDOG"))
        manager.report("1 of 2 processes run;\ndown: depth", ready=True, alive=True)
        assert len(socket.of("WATCHDOG")) == seen + 1
        manager.stopping()
        manager.stopping()
        manager.report("too late", ready=True, alive=True)
        assert socket.heard[:5] == [
            ("STATUS", "starting 3 nodes"),
            ("EXTEND_TIMEOUT_USEC", "120000000"),
            ("READY", "1"),
            ("STATUS", "all 2 processes run"),
            ("WATCHDOG", "1"),
        ]
        assert socket.of("READY") == socket.of("STOPPING") == ["1"]
        assert socket.of("STATUS")[2:] == [
            "a supervisor does not respond",
            "1 of 2 processes run; down: depth",
            "stopping",
        ]


QUICK = RestartPolicy(initial_s=5.0, config_tries=1)


def process(label: str, program: str, console: supervisor.Console = print) -> NodeProcess:
    command = [sys.executable, "-S", "-c", program]
    return NodeProcess(label, command, {}, console, QUICK)


def stop(*processes: NodeProcess) -> None:
    for one in processes:
        one.request_stop()
        one.signal(9)
        assert one.wait_stopped(10)


def test_what_is_down_is_named_with_its_reason_and_is_watched_all_the_same() -> None:
    lives = process("fuel_map", "import time; time.sleep(600)")
    cannot = process("depth", "print('depth: cannot start: no dem.tif'); raise SystemExit(78)")
    assert not lives.watched, "it has not started yet"
    for one in (lives, cannot):
        one.start()
    try:
        wait_for(lambda: lives.running and cannot.failing, "both")
        assert in_words([lives]) == "all 1 processes run"
        said = in_words([lives, cannot])
        why = "exit code 78: its configuration is invalid; depth: cannot start: no dem.tif"
        assert said == f"1 of 2 processes run; down: depth ({why})"
        assert len(in_words([lives, *[cannot] * 9])) == LONGEST
        assert lives.watched
        assert cannot.watched, "a restart does not correct a configuration"
    finally:
        stop(lives, cannot)
    assert lives.watched


def test_a_supervisor_that_hangs_is_noticed() -> None:
    """Here on a console that nobody reads."""
    reads = threading.Event()

    def console(line: str) -> None:
        if "exit code 3" in line:
            reads.wait()

    dies = process("depth", "raise SystemExit(3)", console)
    limit, supervisor.UNWATCHED_S = supervisor.UNWATCHED_S, 0.2
    dies.start()
    try:
        wait_for(lambda: not dies.watched, "the supervisor to be missed")
        reads.set()
        wait_for(lambda: dies.watched, "it to work again")
    finally:
        supervisor.UNWATCHED_S = limit
        stop(dies)
