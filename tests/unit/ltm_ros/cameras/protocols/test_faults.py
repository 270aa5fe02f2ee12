"""What cameras do wrong, one test a fault: each ends in the right state within its time, publishes nothing wrong, and
is over by itself when the camera is well again. A real server; the source's pauses are skipped, not waited for."""

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest
from scenes.http_camera import HttpCamera, running
from scenes.source_under_test import CALIBRATION, Sourced, settings
from scenes.timed_picture import jpeg, scene, time_in, with_time

from ltm_core.base.types import UInt8Array
from ltm_core.storage.image_io import decode_rgb
from ltm_ros.cameras.camera_source import CameraDirection
from ltm_ros.cameras.protocols.credentials import SourceError
from ltm_ros.cameras.protocols.picture import PtzReading
from ltm_ros.runtime.clocks import SystemClock

PASSWORD = "NORTH_PASSWORD"
STALL_S, STUCK_S, SILENT_S = 30.0, 60.0, 1.0


class SkippingClock(SystemClock):
    """This computer's clock, with the pauses that a test skips."""

    def __init__(self) -> None:
        super().__init__()
        self.skipped = 0.0
        self.known_synchronised: bool | None = True

    def wall(self) -> float:
        return super().wall() + self.skipped

    def monotonic(self) -> float:
        return super().monotonic() + self.skipped

    def synchronised(self) -> bool | None:
        return self.known_synchronised


@dataclass
class Head:
    """A PTZ head; `speed`: degrees between two readings; `turn`: from one picture to the next."""

    pan: float = 10.0
    speed: float = 0.0
    turn: float = 0.0
    readings: int = 0
    error: SourceError | None = None

    def read(self) -> PtzReading:
        if self.error is not None:
            raise self.error
        self.pan += self.speed + (self.turn if self.readings % 2 == 0 else 0.0)
        self.readings += 1
        return PtzReading(self.pan, -2.0, 1.0, None, 0.0)

    def close(self) -> None:
        pass


@dataclass
class Bench:
    """A camera that a source asks, with all that can be broken."""

    camera: HttpCamera
    sourced: Sourced
    clock: SkippingClock
    head: Head
    monkeypatch: pytest.MonkeyPatch
    server: contextlib.ExitStack
    undo: list[Callable[[], None]] = field(default_factory=list)

    def change(self, target: object, **changes: Any) -> None:
        former = {name: getattr(target, name) for name in changes}
        vars(target).update(changes)
        self.undo.append(lambda: vars(target).update(former))

    def behave(self, **changes: Any) -> None:
        self.change(self.camera.behaviour, **changes)

    def render(self, picture: Callable[[float], bytes]) -> None:
        self.behave(render=picture)

    def power_off(self) -> None:
        self.server.close()
        self.undo.append(lambda: self.server.enter_context(running(self.camera)))  # type: ignore[arg-type, return-value]

    def replace_by(self, speak: Callable[[socket.socket], None]) -> None:
        """Another program at the camera's port."""
        self.power_off()
        listener = socket.create_server(("127.0.0.1", self.camera.port))
        listener.settimeout(0.05)
        stopping = threading.Event()

        def serve() -> None:
            while not stopping.is_set():
                with contextlib.suppress(OSError):
                    connection, _ = listener.accept()
                    with connection:
                        speak(connection)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()

        def end() -> None:
            stopping.set()
            thread.join()
            listener.close()

        self.undo.append(end)

    def mend(self) -> None:
        for action in reversed(self.undo):
            action()
        self.undo.clear()

    def step(self) -> float:
        """When it was done, before the pause."""
        pause = self.sourced.source.step()
        done = self.clock.monotonic()
        self.clock.skipped += pause
        return done


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setenv(PASSWORD, "tower-%7 secret")
    clock, head = SkippingClock(), Head()
    with contextlib.ExitStack() as server:
        camera = server.enter_context(running())
        config = settings(
            kind="snapshot",
            url=camera.url(),
            every=10,
            timeout=SILENT_S,
            user="viewer",
            password={"environment": PASSWORD},
            stalled_after=STALL_S,
            stuck_after=STUCK_S,
        )
        sourced = Sourced(config, clock, gaze=CameraDirection(direction=head))
        yield Bench(camera, sourced, clock, head, monkeypatch, server)
        sourced.source.close()


def painted(change: Callable[[UInt8Array], UInt8Array], mode: str = "RGB") -> Callable[[float], bytes]:
    return lambda moment: jpeg(change(with_time(scene(), moment)), mode)


def not_http(connection: socket.socket) -> None:
    connection.sendall(b"220 FTP ready\r\n")


@dataclass(frozen=True)
class Fault:
    """`state`: what it ends in, within so many seconds; `said`: in what words."""

    name: str
    happen: Callable[[Bench], object]
    state: str
    within: float
    said: str
    frames: int = 0
    """Published meanwhile, at most."""
    mend: Callable[[Bench], object] = lambda bench: None
    """What a person must do beside mending the camera."""


def right_password(bench: Bench) -> None:
    bench.monkeypatch.setenv(PASSWORD, "tower-%7 secret")


def unset_password(bench: Bench) -> None:
    bench.monkeypatch.delenv(PASSWORD)
    bench.power_off()
    bench.step()
    bench.mend()


def turning_frozen(bench: Bench) -> None:
    """The PTZ head turns from picture to picture; what it shows does not, but for its noise."""
    bench.render(lambda _: jpeg(scene()))
    bench.change(bench.head, turn=30.0)


def turning_seen(bench: Bench) -> None:
    bench.head.turn = 30.0
    bench.camera.behaviour.render = lambda moment: jpeg(with_time(scene(seed=int(bench.head.pan)), moment))


REFUSED = ("unauthorised", 15, "HTTP 401")
FAULTS = (
    Fault("power off", Bench.power_off, "stalled", 50, "no connection"),
    Fault("silent", lambda b: b.behave(stall_s=3.0), "stalled", 50, "does not respond"),
    Fault("connection cut", lambda b: b.behave(cut=True), "stalled", 50, "closed the connection"),
    Fault("picture cut", lambda b: b.behave(truncate=True), "stalled", 50, "end-of-image"),
    Fault("log-in page", lambda b: b.behave(garbage=b"<html>log in</html>"), "stalled", 50, "login page"),
    Fault("broken", lambda b: b.behave(status=500), "stalled", 50, "HTTP 500"),
    Fault("sends elsewhere", lambda b: b.behave(status=302, location="http://127.0.0.1:1/"), "stalled", 50, "address"),
    Fault("wrong password, digest", lambda b: b.behave(authentication="digest", password="x"), *REFUSED),
    Fault("forbidden", lambda b: b.behave(status=403), "unauthorised", 15, "HTTP 403"),
    Fault("password not set", unset_password, "unauthorised", 15, PASSWORD, mend=right_password),
    Fault("no HTTP", lambda b: b.replace_by(not_http), "stalled", 50, "did not answer HTTP"),
    Fault("same bytes", lambda b: b.behave(frozen=True), "stuck", 85, "same image", frames=1),
    Fault("dark", lambda b: b.render(painted(lambda i: i // 16)), "night", 50, "dark"),
    Fault("other size", lambda b: b.render(lambda t: jpeg(scene(640, 360))), "stalled", 50, "640 x 360 pixels"),
    Fault("too large", lambda b: b.render(lambda t: b"\xff\xd8\xff" * 2_000_000), "stalled", 50, "image_bytes"),
    Fault("PTZ head slews", lambda b: b.change(b.head, speed=1.0), "moved", 50, "moving"),
    Fault("PTZ head silent", lambda b: b.change(b.head, error=SourceError("no answer")), "stalled", 50, "no answer"),
    Fault("PTZ head turns, picture stays", turning_frozen, "stuck", 60, "the same", frames=2, mend=turning_seen),
    Fault("camera's clock set by an hour", lambda b: b.behave(clock_ahead=3600.0), "alive", 15, "", frames=1000),
)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_fault(bench: Bench, fault: Fault) -> None:
    sourced = bench.sourced
    bench.step()
    assert (sourced.source.record.state, len(sourced.frames)) == ("alive", 1), sourced.why
    before, began = len(sourced.frames), bench.clock.monotonic()
    fault.happen(bench)
    while True:
        taken = bench.step() - began
        reached = sourced.source.record.state == fault.state and fault.said in sourced.why
        assert taken <= fault.within or reached, (sourced.source.record.state, sourced.why)
        if reached and (fault.state != "alive" or taken > fault.within):
            break
    published = sourced.frames[before:]
    assert len(published) <= fault.frames
    bench.mend()
    fault.mend(bench)
    before = len(sourced.frames)
    for _ in range(6):
        bench.step()
    assert sourced.source.record.state == "alive", sourced.why
    assert len(sourced.frames) > before
    for frame in published + sourced.frames[before:]:
        shown = decode_rgb(frame.jpeg or b"")
        assert shown.shape == (CALIBRATION.height, CALIBRATION.width, 3)
        if frame not in published or fault.name != "PTZ head turns, picture stays":
            late = frame.stamp_ns / 1e9 - time_in(shown)
            assert abs(late) <= frame.uncertainty + 0.05, (frame.told_by, frame.uncertainty)
