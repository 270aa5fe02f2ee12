"""Start the viewer and server processes of Rerun, on loopback only.

Rerun's programs send usage statistics, and its page loads fonts and looks for releases. The processes started here have
a configuration of their own without statistics. The page is served again by our server, without links to other hosts
and with a policy that makes the browser block requests to them."""

import contextlib
import ctypes
import http.client
import json
import os
import re
import shutil
import signal
import socket
import subprocess  # nosec B404 # argument lists, no shell
import sys
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from http import HTTPStatus
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import quote

from ltm_core.base.errors import ConfigError
from ltm_ros.runtime.web_server import Route, WebResponse, WebServer, bind_error

LOOPBACK = "127.0.0.1"
WEB_PORT, GRPC_PORT = 9090, 9876
"""Default ports of the page and of its data."""
LIVE_MEMORY = "384MiB"
"""Memory limit for data that a live view's server keeps for later viewers; with an open viewer, it uses up to twice
that."""
OPEN_MEMORY = "1GiB"
"""Memory limit of the server of a recording."""
_PR_SET_PDEATHSIG = 1
_PROXY_VARIABLES = ("http_proxy", "https_proxy", "all_proxy", "HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY")
_NOWHERE = dict.fromkeys(_PROXY_VARIABLES, f"http://{LOOPBACK}:9") | {"no_proxy": LOOPBACK, "NO_PROXY": LOOPBACK}
"""A proxy that does not exist: the viewer's search for new releases ends there."""
_PAGE_FILES = ("", "index.html", "re_viewer.js", "re_viewer_bg.wasm", "sw.js", "favicon.ico", "apple-touch-icon.png")
_FOREIGN_LINK = re.compile(rb"<link\b[^>]*https?://[^>]*>")


def rerun_binary() -> Path:
    """Return the viewer's binary: the `rerun` script is a wrapper that leaves it running when killed.

    Raises ConfigError if rerun-sdk is not installed."""
    spec = find_spec("rerun_cli")
    folders = (spec.submodule_search_locations or []) if spec else []
    found = [str(path) for folder in folders if (path := Path(folder) / "rerun").is_file()]
    binary = found[0] if found else shutil.which("rerun")
    if binary is None:
        raise ConfigError("the Rerun viewer is not installed: pip install 'ltm[view]'")
    return Path(binary)


def grpc_url(port: int) -> str:
    return f"rerun+http://{LOOPBACK}:{port}/proxy"


def web_url(web_port: int, grpc_port: int) -> str:
    """Return the page that shows the data of the gRPC server at `grpc_port`."""
    return f"http://{LOOPBACK}:{web_port}/?url={quote(grpc_url(grpc_port), safe='')}"


class RerunProcess:
    """A running Rerun binary in its own process group, which ends when this process does."""

    def __init__(self, arguments: Sequence[str]) -> None:
        self._page: WebServer | None = None
        self._config = tempfile.TemporaryDirectory(prefix="ltm-rerun-")
        private = Path(self._config.name, "rerun", "analytics.json")
        private.parent.mkdir()
        settings = {"analytics_enabled": False, "analytics_id": "", "metadata": {}}
        places = {"config_file_path": str(private), "data_dir_path": self._config.name}
        private.write_text(json.dumps(settings | places), encoding="utf-8")
        libc = ctypes.CDLL(None, use_errno=True)
        self._process = subprocess.Popen(  # nosec B603 # no shell, no argument from the wire
            [str(rerun_binary()), "--bind", LOOPBACK, "--hide-welcome-screen", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=os.environ | _NOWHERE | {"XDG_CONFIG_HOME": self._config.name},
            start_new_session=True,
            # The kernel ends it when this process dies, even by SIGKILL, so that its port becomes free.
            preexec_fn=(lambda: libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)) if sys.platform == "linux" else None,
        )

    @classmethod
    def serve(
        cls, web_port: int, grpc_port: int, recording: Path | None = None, memory_limit: str = OPEN_MEMORY
    ) -> "RerunProcess":
        """Start a gRPC server that keeps its data (and `recording`) for late viewers, and the web viewer's page.

        Raises ConfigError if a port is in use or the server does not start."""
        for port in (web_port, grpc_port):
            if (error := bind_error(LOOPBACK, port)) is not None:
                raise ConfigError(f"port {port} on {LOOPBACK} is in use ({error.strerror}): choose another") from error
        with socket.create_server((LOOPBACK, 0)) as free:
            own_page = int(free.getsockname()[1])
        ports = ["--web-viewer-port", str(own_page), "--port", str(grpc_port)]
        files = [str(recording)] if recording is not None else []
        process = cls([*files, "--serve-web", *ports, "--server-memory-limit", memory_limit])
        try:
            for port in (grpc_port, own_page):
                wait_until_listening(port, process._process, "the Rerun server", 20.0)
            process._page = WebServer(_page_routes(own_page, grpc_port), LOOPBACK, web_port)
        except OSError as error:
            process.stop()
            raise ConfigError(f"{LOOPBACK}:{web_port}: {error}") from error
        except ConfigError:
            process.stop()
            raise
        return process

    @property
    def pid(self) -> int:
        return self._process.pid

    def running(self) -> bool:
        return self._process.poll() is None

    def stop(self, grace: float = 3.0) -> None:
        """End the process and all its children."""
        if self._page is not None:
            self._page.close()
            self._page = None
        for number in (signal.SIGTERM, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=grace)
                return


def _page_routes(own_page: int, grpc_port: int) -> dict[str, Route]:
    """Return the routes that serve the page at Rerun's port `own_page` without requests to other hosts."""
    policy = (
        "default-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' data: blob:; "
        f"connect-src 'self' data: blob: http://{LOOPBACK}:{grpc_port}; frame-ancestors 'none'"
    )

    def answer(name: str, _: bytes) -> WebResponse:
        with contextlib.closing(http.client.HTTPConnection(LOOPBACK, own_page, timeout=30)) as connection:
            connection.request("GET", f"/{name}")
            response = connection.getresponse()
            body, kind = response.read(), response.getheader("Content-Type", "application/octet-stream")
        if kind.startswith("text/html"):
            body = _FOREIGN_LINK.sub(b"", body)
        return WebResponse(body, kind, HTTPStatus(response.status), policy)

    return {f"GET /{name}": partial(answer, name) for name in _PAGE_FILES}


def wait_until_listening(port: int, process: subprocess.Popen[bytes], name: str, timeout_s: float) -> None:
    """Wait until a process accepts connections at a loopback port. Raises ConfigError if it ends, or the time passes,
    first."""
    deadline = time.monotonic() + timeout_s
    while not listens(port):
        if process.poll() is not None:
            raise ConfigError(f"{name} ended with exit code {process.returncode} at its start")
        if time.monotonic() > deadline:
            raise ConfigError(f"{name} does not respond on {LOOPBACK}:{port} after {timeout_s:g} s")
        time.sleep(0.05)


def listens(port: int) -> bool:
    """Return whether a process accepts connections at a loopback port."""
    with contextlib.suppress(OSError), socket.create_connection((LOOPBACK, port), timeout=0.2):
        return True
    return False
