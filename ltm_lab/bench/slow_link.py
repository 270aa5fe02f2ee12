"""Measure `ltm view --connect` over a slow link: two network namespaces, joined by a relay that delays and limits.

The relay passes IP packets between two tun devices, as netem does in a kernel that has it. Needs root.
"""

import ctypes
import fcntl
import heapq
import multiprocessing
import os
import select
import struct
import subprocess  # nosec B404 # argument lists, no shell
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import LtmError
from ltm_core.base.resources import project_path
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pictures.legend import to_png
from ltm_core.site.sections import HealthConfig
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.image import compressed_to_rgb
from ltm_ros.runtime.web_server import WebResponse, WebServer
from ltm_ros.tower.health_client import RejectedError, TowerPort, open_health_server
from ltm_ros.tower.last_pictures import SMALL_QUALITY, CameraPicture
from ltm_ros.tower.live_stream import KINDS, LiveStream
from ltm_ros.tower.tower_mirror import TowerMirror

TOKEN = "0123456789abcdef-slow-link"  # nosec B105 # of a server that lives for a minute, in its own network
ADDRESSES = ("10.99.0.1", "10.99.0.2")
"""Of tower and laptop."""
QUEUE_BYTES = 64 << 10
"""Bytes that the link's buffer holds; more packets are lost."""
_CLONE_NEWNET, _TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x40000000, 0x400454CA, 0x0001, 0x1000


@dataclass(frozen=True)
class SlowLinkResult:
    """`first_s`: until the first image; `behind_s`: greatest age of an image after that, with frames of each camera
    once a second; `mbit_s`: most in any second, in both directions, with all headers."""

    first_s: float
    behind_s: float
    mbit_s: float
    listening: list[str]
    """TCP sockets on the laptop that listen."""


class _Scene:
    """Cameras that send a frame once a second: the demo's photos, moved by a pixel each time."""

    def __init__(self, cameras: int) -> None:
        bag = BagReader(project_path("bags/demo/recording"))
        topic = next(name for name in bag.topics() if name.endswith("image_raw/compressed"))
        photo = compressed_to_rgb(bag.decode(next(iter(bag.messages([topic])))))
        self._photo = np.ascontiguousarray(photo[:: max(1, photo.shape[1] // 800), :: max(1, photo.shape[1] // 800)])
        self._cameras, self._labels = [f"camera_{number}" for number in range(cameras)], LabelSet.load()
        height, width = self._photo.shape[:2]
        self._classes = (np.indices((height, width)).sum(0) // 60 % 3).astype(np.uint8)
        self._depth = np.repeat(np.geomspace(9000, 40, height, dtype=np.float32)[:, None], width, 1)
        self._begun = time.time()

    def stamps_s(self) -> dict[str, float]:
        """Return the stamps, spread over the second."""
        spread = {name: number / len(self._cameras) for number, name in enumerate(self._cameras)}
        return {name: self._begun + int(time.time() - self._begun - part) + part for name, part in spread.items()}

    def shown(self, camera: str) -> CameraPicture:
        stamp_s = self.stamps_s()[camera]
        photo = np.roll(self._photo, round(stamp_s - self._begun) % 100, axis=1)
        height, width = photo.shape[:2]
        optics, pose = Camera.from_fov(width, height, 50.0), Pose.from_angles((0.0, 0.0, 0.0), 0.0, 0.0)
        return CameraPicture(camera, round(stamp_s * 1e9), photo, self._classes, self._depth, optics, pose)

    def jpegs(self, picture: CameraPicture, width: int) -> list[bytes]:
        small = picture.resized(width)
        return [small.jpeg(kind, self._labels, SMALL_QUALITY) for kind in KINDS]

    def map_png(self) -> bytes:
        """Return a map of which a part changes every five seconds."""
        image = np.full((600, 800, 3), 190, np.uint8)
        image[::7, :, 1] = image[:, ::11, 2] = 120
        part = int(time.time() / 5) % 16
        image[part // 4 * 128 : part // 4 * 128 + 99, part % 4 * 128 : part % 4 * 128 + 99] = 60
        return to_png(image)

    def page(self) -> dict[str, Any]:
        node = {"name": "/site/camera/segmentation", "state": "ok", "said": "", "values": {"frames_in": "123456"}}
        return {"site": "slow", "pictures": self.stamps_s(), "nodes": [node] * 6 * len(self._cameras)}


def measure_slow_link(cameras: int, seconds: float, mbit_s: float = 1.0, round_trip_s: float = 0.3) -> SlowLinkResult:
    """Show a tower for some seconds over a link of this rate and round-trip time. Raises LtmError without root, and if
    a wrong token is accepted."""
    if os.geteuid() != 0:
        raise LtmError("network namespaces need root: run it with sudo, or in a container with CAP_NET_ADMIN")
    with ExitStack() as stack:
        names = [stack.enter_context(_namespace(f"ltm-slow-{side}-{os.getpid()}")) for side in ("tower", "laptop")]
        ends = [_tun(name, own, other) for name, own, other in zip(names, ADDRESSES, ADDRESSES[::-1], strict=True)]
        relay = _Relay(ends, mbit_s * 125_000, round_trip_s / 2)
        stack.callback(relay.close)
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="ltm-slow-")))
        _certificate(folder)
        context = multiprocessing.get_context("spawn")
        ready, done = context.Event(), context.Event()
        stack.callback(done.set)
        tower = context.Process(target=_tower, args=(names[0], folder, cameras, ready, done), daemon=True)
        tower.start()
        if not ready.wait(60.0):
            raise LtmError("the tower of the measurement did not start within 60 s")
        answers = context.SimpleQueue()
        laptop = context.Process(target=_laptop, args=(names[1], folder, seconds, answers), daemon=True)
        laptop.start()
        laptop.join(seconds + 60.0)
        if laptop.exitcode != 0:
            raise LtmError(f"the laptop of the measurement ended with exit code {laptop.exitcode}")
        first_s, behind_s, listening = answers.get()
        return SlowLinkResult(first_s, behind_s, relay.most_bytes_s() * 8e-6, listening)


def _tower(namespace: str, folder: Path, cameras: int, ready: Any, done: Any) -> None:
    _enter(namespace)
    scene: Any = _Scene(cameras)
    live = LiveStream(scene.page, scene, _fail)
    server: WebServer = open_health_server(
        HealthConfig(
            address=ADDRESSES[0],
            port=9464,
            certificate=folder / "cert.pem",
            key=folder / "key.pem",
            token=folder / "token",
        ),
        {"GET /live": lambda _: WebResponse(b"", "application/octet-stream", stream=live.stream())},
    )
    ready.set()
    done.wait()
    server.close()


def _fail(error: LtmError) -> None:
    raise error


def _laptop(namespace: str, folder: Path, seconds: float, answers: Any) -> None:
    _enter(namespace)
    (folder / "wrong").write_text(TOKEN[::-1])
    url = f"https://{ADDRESSES[0]}:9464"
    wrong, right = (TowerPort.of_url(url, folder / token, folder / "cert.pem") for token in ("wrong", "token"))
    try:
        TowerMirror(lambda: wrong)
    except RejectedError:
        pass
    else:
        raise LtmError("a wrong token is accepted")
    begun = time.monotonic()
    with closing(TowerMirror(lambda: right)) as mirror:
        while not (stamps := mirror.stamps_s()) and time.monotonic() - begun < 60.0:
            time.sleep(0.02)
        first_s, behind_s = time.monotonic() - begun, 0.0
        while time.monotonic() - begun < seconds:
            stamps = mirror.stamps_s()
            if time.monotonic() - begun > first_s + 5.0:  # each camera's first image
                behind_s = max(behind_s, max(time.time() - stamp for stamp in stamps.values()))
            time.sleep(0.05)
        lines = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
        answers.put((first_s, behind_s, [line[1] for line in lines if line[3] == "0A"]))


class _Relay:
    """Passes packets between two tun devices: first through a queue of the link's rate, then with its delay."""

    def __init__(self, ends: list[int], bytes_s: float, delay_s: float) -> None:
        self._ends, self._bytes_s, self._delay_s = ends, bytes_s, delay_s
        self._passed: list[tuple[float, int]] = []
        self._closing = threading.Event()
        self._threads = [threading.Thread(target=self._pass, args=pair, daemon=True) for pair in (ends, ends[::-1])]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        self._closing.set()
        for thread in self._threads:
            thread.join()
        for end in self._ends:
            os.close(end)

    def most_bytes_s(self) -> float:
        """Return the most bytes that passed within any whole second."""
        seconds = [int(moment) for moment, _ in self._passed]
        sizes = np.bincount(np.array(seconds) - min(seconds), [size for _, size in self._passed])
        return float(sizes.max())

    def _pass(self, source: int, target: int) -> None:
        free_at, waiting = 0.0, list[tuple[float, bytes]]()
        while not self._closing.is_set():
            now = time.monotonic()
            while waiting and waiting[0][0] <= now:
                os.write(target, heapq.heappop(waiting)[1])
            pause = min(0.05, waiting[0][0] - now) if waiting else 0.05
            if not select.select([source], [], [], max(0.0, pause))[0]:
                continue
            packet, now = os.read(source, 65536), time.monotonic()
            if (free_at - now) * self._bytes_s > QUEUE_BYTES:
                continue
            free_at = max(now, free_at) + len(packet) / self._bytes_s
            self._passed.append((free_at, len(packet)))
            heapq.heappush(waiting, (free_at + self._delay_s, packet))


@contextmanager
def _namespace(name: str) -> Iterator[str]:
    subprocess.run(["ip", "netns", "add", name], check=True)  # nosec B603 B607
    try:
        yield name
    finally:
        subprocess.run(["ip", "netns", "delete", name], check=False)  # nosec B603 B607


def _tun(namespace: str, own: str, other: str) -> int:
    """Return a tun device in the namespace, with these addresses."""

    made: list[int] = []

    def make() -> None:
        _enter(namespace)
        made.append(os.open("/dev/net/tun", os.O_RDWR))
        fcntl.ioctl(made[0], _TUNSETIFF, struct.pack("16sH22x", b"slow", _IFF_TUN | _IFF_NO_PI))

    thread = threading.Thread(target=make)  # a thread enters a namespace by itself
    thread.start()
    thread.join()
    if not made:
        raise LtmError("/dev/net/tun cannot be opened; run it with root's rights on networks")
    for command in (f"addr add {own} peer {other} dev slow", "link set slow up", "link set lo up"):
        subprocess.run(["ip", "-n", namespace, *command.split()], check=True)  # nosec B603 B607
    return made[0]


def _enter(namespace: str) -> None:
    with Path(f"/run/netns/{namespace}").open() as file:
        if ctypes.CDLL(None, use_errno=True).setns(file.fileno(), _CLONE_NEWNET) != 0:
            raise LtmError(f"network namespace {namespace} cannot be entered ({os.strerror(ctypes.get_errno())})")


def _certificate(folder: Path) -> None:
    command = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -subj /CN=tower -days 2"
    files = ["-keyout", str(folder / "key.pem"), "-out", str(folder / "cert.pem")]
    subprocess.run([*command.split(), *files], check=True, capture_output=True)  # nosec B603 B607
    (folder / "token").write_text(TOKEN)
