"""An RTSP camera on loopback: GStreamer's server in a process of its own; a skip says where that cannot be had."""

import contextlib
import signal
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import pytest

from scenes.free_port import free_port

SYSTEM_PYTHON = "/usr/bin/python3"
SERVER = Path(__file__).with_name("rtsp_server_process.py")
NEEDED = "gi.require_version('GstRtspServer', '1.0'); from gi.repository import Gst, GstRtspServer; Gst.init(None)"
SIZE = (320, 192)
USER, PASSWORD = "viewer", "tower-%7 secret"


@cache
def missing() -> str:
    """What keeps the server from running; empty: nothing."""
    code = f"import gi; {NEEDED}; assert Gst.ElementFactory.find('x264enc')"
    try:
        subprocess.run([SYSTEM_PYTHON, "-c", code], check=True, capture_output=True, timeout=60)
    except (OSError, subprocess.SubprocessError):
        return (
            "GStreamer's RTSP server is not installed (apt: gir1.2-gst-rtsp-server-1.0 gstreamer1.0-rtsp "
            "python3-gst-1.0 gstreamer1.0-plugins-ugly)"
        )
    return ""


@dataclass
class RtspCamera:
    """`ahead`: seconds by which the camera's clock is wrong."""

    ahead: float = 0.0
    authentication: str = ""
    """`basic` or `digest`; empty: none."""
    keys: int = 5
    """Pictures, at ten a second, from one key frame to the next."""
    shown: Path | None = None
    """File of a picture of `SIZE` as I420, which it shows; None: a scene that tells the time."""
    port: int = 0
    process: subprocess.Popen[str] | None = field(default=None, repr=False)

    @property
    def url(self) -> str:
        return f"rtsp://127.0.0.1:{self.port}/live"

    def start(self) -> None:
        self.port = self.port or free_port()
        command = [SYSTEM_PYTHON, str(SERVER), str(self.port), "--ahead", str(self.ahead), "--keys", str(self.keys)]
        command += ["--i420", str(self.shown)] if self.shown is not None else []
        command += ["--password", PASSWORD] if self.authentication else []
        command += ["--digest"] if self.authentication == "digest" else []
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "ready\n"

    def stall(self) -> None:
        """Stop sending, with all connections open."""
        assert self.process is not None
        self.process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        assert self.process is not None
        self.process.send_signal(signal.SIGCONT)

    def kill(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            assert self.process.stdout is not None
            self.process.stdout.close()
            self.process = None


@contextlib.contextmanager
def running(camera: RtspCamera) -> Iterator[RtspCamera]:
    """Skips the test where there is no server, or no PyAV."""
    if why := missing():
        pytest.skip(why)
    pytest.importorskip("av", reason="the extra rtsp is not installed")
    camera.start()
    try:
        yield camera
    finally:
        camera.kill()
