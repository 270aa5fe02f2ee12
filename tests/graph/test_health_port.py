"""A port of health that somebody else has: the tower runs, says so, and answers once it is free."""

from __future__ import annotations

import http.client
import signal
import socket
import subprocess
import sys
from contextlib import closing, suppress
from pathlib import Path

import pytest
import yaml
from bystander import Bystander
from scenes.free_port import free_port
from scenes.small_site import NAME, SmallSite
from scenes.waiting import wait_for

pytestmark = pytest.mark.graph
pytest.importorskip("prometheus_client", reason="the extra `tower` is not installed")

LTM = "from ltm_ros.cli.main import app; app()"


def healthz(port: int) -> int:
    """Its status; 0 while nobody answers."""
    with suppress(OSError), closing(http.client.HTTPConnection("127.0.0.1", port, timeout=20)) as connection:
        connection.request("GET", "/healthz")
        return connection.getresponse().status
    return 0


def test_a_tower_starts_without_its_port_and_answers_once_it_is_free(
    kernels: None, small: SmallSite, ros_domain: int, tmp_path: Path
) -> None:
    port, console = free_port(), tmp_path / "console"
    keys = yaml.safe_load(small.path.read_text())
    small.path.write_text(yaml.safe_dump(keys | {"health": {"port": port}}))
    command = [sys.executable, "-c", LTM, "run", str(small.path), "--only", "tower"]
    command += ["--state", str(tmp_path / "state"), "--logs", str(tmp_path / "logs")]
    taken = socket.create_server(("127.0.0.1", port))
    with console.open("w") as lines:
        graph = subprocess.Popen(command, stdout=lines, stderr=subprocess.STDOUT)
        try:
            with Bystander() as bystander:  # gone before the tower is: ports that it maps could not be removed
                wait_for(
                    lambda: (
                        {f"/{NAME}/health", f"/{NAME}/fuel_map", f"/{NAME}/tower/capture"} <= set(bystander.summaries)
                    ),
                    "all nodes",
                    console.read_text,
                    patience_s=180.0,
                )
                said = f"port: 127.0.0.1:{port} cannot be opened (Address already in use)"
                wait_for(
                    lambda: bystander.summaries[f"/{NAME}/health"]["last_error"].startswith(said),
                    "the node's word of it",
                    lambda: bystander.summaries[f"/{NAME}/health"],
                )
            assert f"machine, health: {said.removeprefix('port: ')}" in console.read_text()
            taken.close()
            wait_for(lambda: healthz(port) == 200, "an answer", console.read_text)
            graph.send_signal(signal.SIGTERM)
            assert graph.wait(60) == 0
        finally:
            taken.close()
            graph.kill()
            graph.wait()
