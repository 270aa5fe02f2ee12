"""Count a node's rates, latencies and drops, and hold the states of cameras and their photos."""

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ltm_core.base.errors import LtmError
from ltm_core.site.sections import MessageLimits
from ltm_core.site.site import SITE_NAMES
from ltm_core.vision.scene_view import SceneView

WINDOW = 200
"""Number of messages over which latencies are summarised."""


def cause_of(error: LtmError) -> str:
    """Return the name under which an error is counted: ImageError -> image."""
    return type(error).__name__.removesuffix("Error").lower()


class Health:
    """Counters of one node; thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._received: Counter[str] = Counter()
        self._published: Counter[str] = Counter()
        self._dropped: Counter[str] = Counter()
        self._noted: Counter[str] = Counter()
        self._gauges: dict[str, str] = {}
        self._ages = deque[float](maxlen=WINDOW)
        self._warm_ns = 0
        """Time of the first result, by the clock that stamps frames."""
        self._work = deque[float](maxlen=WINDOW)
        self._cpu_s: float | None = None
        self._published_at = deque[float](maxlen=WINDOW)
        self._reasons: dict[str, str] = {}
        self.last_error = ""
        """The last problem, after its cause."""
        self._lasting = ""
        self._last_trouble = -float("inf")

    def received(self, topic: str) -> None:
        with self._lock:
            self._received[topic] += 1

    def published(self, topic: str, stamp_ns: int | None = None, now_ns: int = 0) -> None:
        """Count a published result of a frame with this stamp; 0 or None: a time is not known.

        The latency counts frames that were captured after the first result, because earlier ones wait for networks and
        code that are used for the first time."""
        with self._lock:
            self._published[topic] += 1
            self._published_at.append(time.monotonic())
            if stamp_ns is not None and now_ns:
                self._warm_ns = min(self._warm_ns or now_ns, now_ns)  # a replay may start again
                if stamp_ns >= self._warm_ns:
                    self._ages.append((now_ns - stamp_ns) / 1e9)

    def worked(self, seconds: float) -> None:
        """Count a message that was handled in `seconds`."""
        with self._lock:
            self._work.append(seconds)

    def used(self, cpu_s: float) -> None:
        """Add processor time of this node; for nodes that share a process."""
        with self._lock:
            self._cpu_s = cpu_s + (self._cpu_s or 0.0)

    @property
    def results(self) -> int:
        """Return the number of published messages."""
        with self._lock:
            return self._published.total()

    def drop(self, cause: str, why: str, count: int = 1) -> None:
        """Count dropped inputs; `why` holds the value and the remedy. The first of each cause is kept."""
        with self._lock:
            self._dropped[cause] += count
            self._reasons.setdefault(cause, why)
        self.trouble(cause, why)

    def trouble(self, cause: str, why: str) -> None:
        """Report a problem that has lost nothing so far; `why` holds the value and the remedy."""
        with self._lock:
            self.last_error = f"{cause}: {why}"
            self._last_trouble = time.monotonic()

    def lasting(self, problem: str) -> None:
        """Report a problem that lasts until the next call; empty: none."""
        self._lasting = problem

    def doubt(self, cause: str, why: str) -> None:
        """Report a lasting problem that loses nothing, and count it; an empty `why` reports its end."""
        with self._lock:
            self._reasons.pop(cause, None)
            if not why:
                return
            self._noted[cause] += 1
            self._reasons[cause] = why
        self.trouble(cause, why)

    def note(self, event: str) -> None:
        """Count an event that loses nothing."""
        with self._lock:
            self._noted[event] += 1

    def gauge(self, name: str, value: object) -> None:
        """Set a current value, such as a queue's length."""
        with self._lock:
            self._gauges[name] = str(value)

    @property
    def dropped(self) -> dict[str, int]:
        with self._lock:
            return dict(self._dropped)

    @property
    def troubled(self) -> bool:
        """Return whether a problem lasts, or something was dropped in the last ten seconds."""
        return bool(self._lasting) or time.monotonic() - self._last_trouble < 10.0

    @property
    def message(self) -> str:
        """Return the current problem in words; `ok`: none."""
        return self._lasting or (self.last_error if self.troubled else "ok")

    def summary(self) -> dict[str, str]:
        """Return key -> value for `/diagnostics`; times in milliseconds, rates in Hz."""
        with self._lock:
            values = {"frames_in": str(_frames(self._received)), "frames_out": str(_frames(self._published))}
            values |= {"received": str(self._received.total()), "published": str(self._published.total())}
            values["dropped"] = str(sum(self._dropped.values()))
            values |= {f"dropped.{cause}": str(n) for cause, n in sorted(self._dropped.items())}
            values |= {f"reason.{cause}": why for cause, why in sorted(self._reasons.items())}
            values |= {f"noted.{event}": str(n) for event, n in sorted(self._noted.items())}
            values["rate_hz"] = f"{_rate(self._published_at):.2f}"
            for name, window in (("latency", self._ages), ("work", self._work)):
                if window:
                    p50, p95 = np.percentile(np.multiply(window, 1000), (50, 95))
                    values |= {f"{name}_p50_ms": f"{p50:.1f}", f"{name}_p95_ms": f"{p95:.1f}"}
            if self._cpu_s is not None:
                values["cpu_s"] = f"{self._cpu_s:.3f}"
            values |= self._gauges
            values["last_error"] = self.last_error
            return values


def _frames(messages: Counter[str]) -> int:
    """Return the number of frames: a frame has one message on each topic of its camera, so the topic with most messages
    counts. Topics of the site and `/diagnostics` carry no frames of a camera."""
    fullest: dict[str, int] = {}
    for topic, count in messages.items():
        parts = topic.split("/")
        if topic.startswith("/") and (len(parts) < 4 or parts[2] in SITE_NAMES):
            continue
        camera = parts[2] if topic.startswith("/") else ""
        fullest[camera] = max(fullest.get(camera, 0), count)
    return sum(fullest.values())


def _rate(moments: Iterable[float]) -> float:
    recent = [moment for moment in moments if moment > time.monotonic() - 10.0]
    return (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 and recent[-1] > recent[0] else 0.0


def too_many_pixels(health: Health, what: str, width: int, height: int, most: int) -> bool:
    """Return whether an image or calibration has more pixels than the site's limit; then it is counted as dropped."""
    if width * height <= most:
        return False
    size = f"{what} of {width} x {height} pixels; the maximum is {most}"
    health.drop("too_large", f"{size}; reduce the size, or raise pixels under `expert.limits` in the site file")
    return True


def too_large(
    health: Health, limits: MessageLimits, raw: bool, size_bytes: int, size: tuple[int, int] | None = None
) -> bool:
    """Return whether an image exceeds the site's limits; then it is counted as dropped. `size`: (width, height), if
    known."""
    if size is not None and too_many_pixels(health, "image", *size, limits.pixels):
        return True
    # The largest supported raw encoding has four bytes per pixel.
    key, most = ("pixels", 4 * limits.pixels) if raw else ("image_bytes", limits.image_bytes)
    if size_bytes > most:
        remedy = f"reduce the size, or raise {key} under `expert.limits` in the site file"
        health.drop("too_large", f"image of {size_bytes} bytes; the maximum is {most}; {remedy}")
    return size_bytes > most


def note_picture(health: Health, seen: SceneView) -> None:
    """Count an unusable image by its reason, and report the state of the last one."""
    if seen.reason is not None:
        health.note(f"unusable.{seen.reason}")
    if seen.smoke > 0:
        health.note("smoke")
    smoke = "" if seen.smoke == 0 else f"usable except {seen.smoke:.1%} (smoke in front of the land)"
    doubtful = "" if seen.doubtful is None else f"usable except {seen.doubtful.mean():.0%} (overexposed or black)"
    if seen.masked:
        health.gauge("mask", seen.masked)
    health.gauge("picture", seen.unusable or smoke or doubtful or "usable")


class CameraState(StrEnum):
    CONNECTING = "connecting"
    """Before the first image."""
    ALIVE = "alive"
    STALLED = "stalled"
    """No usable image: not reachable, connection lost, or invalid data."""
    UNAUTHORISED = "unauthorised"
    """The camera rejected the user or password, or the password cannot be read."""
    STUCK = "stuck"
    """The camera repeats the same image, or the image does not change with the PTZ head."""
    MOVED = "moved"
    """The PTZ head moved during the exposures."""
    NIGHT = "night"
    """The image is dark, or infrared."""

    @property
    def failing(self) -> bool:
        """Return whether the camera needs a repair."""
        return self in (CameraState.STALLED, CameraState.UNAUTHORISED, CameraState.STUCK)

    @property
    def sending(self) -> bool:
        return self in (CameraState.ALIVE, CameraState.NIGHT, CameraState.MOVED)


class StateRecord:
    """The current state, from what each request showed. A single failure does not change it: a state ends when it has
    not been seen for `hold_s` seconds. Rejected passwords count at once, and so does the first good image afterwards.

    Args: now, hold_s: seconds of the caller's clock."""

    def __init__(self, now: float, hold_s: float) -> None:
        self.state = self.latest = CameraState.CONNECTING
        """The camera's state, and what the latest request showed."""
        self.since = self._seen = now
        self._hold_s = hold_s
        self.why = ""
        """Reason of the latest failure; empty: the latest request succeeded."""

    def saw(self, state: CameraState, now: float, why: str = "") -> bool:
        """Take what a request showed; return whether the camera's state changed."""
        self.latest, self.why = state, why
        recovered = self.state.failing and state in (CameraState.ALIVE, CameraState.NIGHT)
        at_once = self.state is CameraState.CONNECTING or state is CameraState.UNAUTHORISED or recovered
        if state is self.state:
            self._seen = now
        elif at_once or now - self._seen >= self._hold_s:
            self.state, self.since, self._seen = state, now, now
            return True
        return False


@dataclass(frozen=True)
class NodeRow:
    """Final report of a node; latencies since capture, NaN without any."""

    node: str
    received: int
    published: int
    dropped: int
    latency_p50_ms: float = math.nan
    latency_p95_ms: float = math.nan
    work_p50_ms: float = math.nan
    causes: str = ""
    """Causes of drops: `overload 2, pose 1`."""
    reasons: tuple[str, ...] = ()
    """Reason of the first drop of each cause, and of each lasting problem, after its name."""


def node_rows(summaries: Mapping[str, Mapping[str, str]]) -> list[NodeRow]:
    """Return one row per node, by name, from the key -> value texts of their `/diagnostics` statuses."""
    rows = []
    for node, summary in sorted(summaries.items()):
        received, sent, dropped = (int(summary.get(key, 0)) for key in ("frames_in", "frames_out", "dropped"))
        keys = ("latency_p50_ms", "latency_p95_ms", "work_p50_ms")
        p50, p95, work = (float(summary.get(key, math.nan)) for key in keys)
        said = [(*key.partition(".")[::2], value) for key, value in summary.items()]
        causes = ", ".join(f"{cause} {count}" for kind, cause, count in said if kind == "dropped" and cause)
        reasons = tuple(f"{cause}: {why}" for kind, cause, why in said if kind == "reason")
        rows.append(NodeRow(node, received, sent, dropped, p50, p95, work, causes, reasons))
    return rows
