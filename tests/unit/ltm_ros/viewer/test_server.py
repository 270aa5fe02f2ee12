"""The Rerun server: where it listens, and when it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from scenes.free_port import free_port
from scenes.rerun_site import LABELS, hills, site
from scenes.waiting import wait_for

from ltm_core.base.errors import ConfigError

pytest.importorskip("rerun", reason="the viewer's extra is not installed")

from ltm_ros.viewer import RerunView
from ltm_ros.viewer.server import RerunProcess, grpc_url, listens, web_url


@pytest.fixture
def ports() -> tuple[int, int]:
    return free_port(), free_port()


def listening(port: int) -> list[str]:
    """Local addresses, in hex as the kernel prints them, of the sockets that listen at a port."""
    found = []
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            address, state = line.split()[1], line.split()[3]
            if state == "0A" and int(address.split(":")[1], 16) == port:
                found.append(address.split(":")[0])
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc/net")
def test_server_listens_on_loopback_only_and_ends_with_the_view(tmp_path: Path, ports: tuple[int, int]) -> None:
    web, grpc = ports
    view = RerunView("ltm ridge", site(north={}), hills(), LABELS, serve=True, web_port=web, grpc_port=grpc)
    try:
        assert view.url == web_url(web, grpc)
        assert listening(web) == ["0100007F"]
        assert listening(grpc) == ["0100007F"]
        with pytest.raises(ConfigError, match=f"port {web}"):
            RerunProcess.serve(web, grpc)
    finally:
        view.close()
    assert not listens(web)
    assert not listens(grpc)


@pytest.mark.skipif(sys.platform != "linux", reason="the parent-death signal is Linux's")
def test_server_ends_when_its_process_is_killed(ports: tuple[int, int]) -> None:
    web, grpc = ports
    code = (
        "import time\nfrom ltm_ros.viewer.server import RerunProcess\n"
        f"RerunProcess.serve({web}, {grpc})\nprint('up', flush=True)\ntime.sleep(60)\n"
    )
    owner = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[4]
    )
    try:
        assert owner.stdout is not None
        assert owner.stdout.readline() == "up\n"
        assert listens(grpc)
    finally:
        os.kill(owner.pid, signal.SIGKILL)
        owner.wait()
    wait_for(lambda: not listens(grpc), "the server's end")


def test_urls_name_the_loopback() -> None:
    assert grpc_url(9876) == "rerun+http://127.0.0.1:9876/proxy"
    assert web_url(9090, 9876) == "http://127.0.0.1:9090/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A9876%2Fproxy"
