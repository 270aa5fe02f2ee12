import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from scenes.free_port import free_port
from scenes.rerun_site import LABELS, hills, site
from scenes.waiting import wait_for

from ltm_core.base.errors import ConfigError

pytest.importorskip("rerun", reason="the viewer's extra is not installed")

from ltm_ros.viewer import RerunView
from ltm_ros.viewer.server import RerunProcess, listens, rerun_binary, web_url


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
        assert owner.stdout.readline() == "up\n"
        assert listens(grpc)
    finally:
        os.kill(owner.pid, signal.SIGKILL)
        owner.wait()
    wait_for(lambda: not listens(grpc), "the server's end")


def test_rerun_sends_no_statistics_and_the_page_asks_no_other_host(ports: tuple[int, int], tmp_path: Path) -> None:
    """In a real browser: the page loads its program, draws, and requests nothing beyond the loopback."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install 'ltm[dev]'")
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("needs a browser: apt install chromium")
    web, grpc = ports
    process = RerunProcess.serve(web, grpc)
    asked: list[str] = []
    try:
        with playwright.sync_playwright() as tools:
            page = tools.chromium.launch(executable_path=browser, args=["--no-sandbox"]).new_page()
            page.on("request", lambda request: asked.append(request.url))
            page.goto(web_url(web, grpc))
            page.wait_for_selector("canvas.visible", state="attached", timeout=120_000)
            page.wait_for_timeout(3000)
    finally:
        process.stop()
    hosts = {urlsplit(url).netloc for url in asked if not url.startswith(("data:", "blob:"))}
    assert f"127.0.0.1:{web}" in hosts
    assert hosts <= {f"127.0.0.1:{web}", f"127.0.0.1:{grpc}"}


def test_the_processes_have_statistics_switched_off(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Rerun's own command states what it read; the user's settings stay as they are."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    process = RerunProcess(["analytics", "config"])
    environment = Path(f"/proc/{process.pid}/environ").read_bytes().split(b"\0")
    (folder,) = (Path(os.fsdecode(v.partition(b"=")[2])) for v in environment if v.startswith(b"XDG_CONFIG_HOME="))
    told = subprocess.run(
        [str(rerun_binary()), "analytics", "config"],
        env=os.environ | {"XDG_CONFIG_HOME": str(folder)}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    process.stop()
    assert json.loads(told.stdout)["analytics_enabled"] is False
    assert not list(tmp_path.iterdir())
