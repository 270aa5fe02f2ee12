import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from scenes.notify_socket import NotifySocket
from scenes.small_site import SmallSite
from scenes.waiting import wait_for

pytestmark = pytest.mark.graph

LTM = "from ltm_ros.cli.main import app; app()"
WATCHDOG_S = 0.6


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[NotifySocket]:
    with NotifySocket(tmp_path / "notify") as socket:
        yield socket


def process_of(label: str, console: Path) -> int:
    """The process that was started last."""
    *_, last = (line for line in console.read_text().splitlines() if f"[{label}] -- started as process" in line)
    return int(last.rpartition(" ")[2])


def test_the_manager_hears_all_of_a_life_and_no_camera_matters(
    small_site: SmallSite, ros_domain: int, manager: NotifySocket, tmp_path: Path
) -> None:
    # As systemd does it: the shell's number stays the service's.
    command = f'WATCHDOG_PID=$$ exec {sys.executable} -c "{LTM}" run {small_site.path} --only tower'
    environment = os.environ | {"NOTIFY_SOCKET": manager.address, "WATCHDOG_USEC": str(round(WATCHDOG_S * 1e6))}
    console = (tmp_path / "console").open("w+")
    graph = subprocess.Popen(["/bin/sh", "-c", command], env=environment, stdout=console, stderr=subprocess.STDOUT)

    def told() -> str:
        return f"{manager.heard}\n{(tmp_path / 'console').read_text()}"

    def signs_of_life() -> int:
        return len(manager.of("WATCHDOG"))

    try:
        wait_for(lambda: manager.of("READY"), "READY", told, patience_s=180.0)
        assert any(status.startswith("starting") for status in manager.of("STATUS"))
        assert manager.of("EXTEND_TIMEOUT_USEC"), "more time was asked for"
        assert "nodes are ready" in (tmp_path / "console").read_text()
        # No camera sends anything, ever: the service lives.
        wait_for(lambda: signs_of_life() >= 5, "signs of life", told)
        status = Path(f"/proc/{graph.pid}/status").read_text()
        assert "THP_enabled:\t0" in status, "no huge page is made of what the site's check has left in the heap"

        os.kill(process_of("fuel_map", tmp_path / "console"), signal.SIGKILL)
        wait_for(lambda: any("down: fuel_map (killed by SIGKILL)" in s for s in manager.of("STATUS")), "word", told)
        seen = signs_of_life()
        wait_for(lambda: re.fullmatch(r"all \d processes run", manager.of("STATUS")[-1]), "it to be back", told)
        wait_for(lambda: signs_of_life() > seen, "signs of life after a process was killed", told)
        assert manager.of("READY") == ["1"], "told once"

        graph.send_signal(signal.SIGTERM)
        assert graph.wait(60) == 0
        assert manager.heard[-2:] == [("STOPPING", "1"), ("STATUS", "stopping")]
    finally:
        graph.kill()
        graph.wait()
        console.close()
