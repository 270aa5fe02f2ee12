"""Compute the state of a tower from its nodes' reports on `/diagnostics`; pure data, no ROS.

Metrics, `ltm status`, the status page and the health checks all use it, so they cannot contradict each other."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from ltm_ros.runtime.health import CameraState
from ltm_ros.tower.machine import Condition, Machine

SILENT_S = 10.0
"""Seconds without diagnostics after which a node counts as dead; diagnostics come once a second."""
KEYS = 300
"""Maximum number of values kept per node, and"""
LENGTH = 400
"""maximum characters of each: any program may publish on the topic."""
LARGEST_COUNT = 2.0**53
"""Largest integer that JSON and Prometheus represent exactly."""
OUTBOX_KEYS = ("outbox_frames", "outbox_bytes", "outbox_age_s", "link_up")
"""Keys of the outbox in the reports of node `uplink`."""


@dataclass(frozen=True)
class NodeState:
    """State of a node, by its last report."""

    name: str
    camera: str
    """Empty: a node of the whole site."""
    state: str
    """`ok`, `warning` (dropped something in the last ten seconds), `silent` or `missing` (never reported)."""
    said: str
    age_s: float | None
    values: Mapping[str, str]

    def number(self, key: str) -> float | None:
        """Return a value that is a finite number."""
        try:
            value = float(self.values[key])
        except (KeyError, ValueError):
            return None
        return value if math.isfinite(value) else None

    def counts(self, prefix: str) -> dict[str, int]:
        """Return counters by prefix: `dropped.` -> {"shed": 3, ...}."""
        found = {key.removeprefix(prefix): self.number(key) for key in self.values if key.startswith(prefix)}
        return {key: int(n) for key, n in found.items() if n is not None and 0 <= n < LARGEST_COUNT}


@dataclass(frozen=True)
class CameraStatus:
    """State of a camera. Its node `source` decides it; without one, and for frames that do not arrive, their age."""

    name: str
    state: CameraState
    since_s: float
    """Start of the state, in seconds by the system clock."""
    why: str
    """Reason of the state, or of the latest failure; empty: none."""
    frame_age_s: float | None
    """Seconds since the stamp of its newest frame; None: no frame yet."""
    frames_in: int
    finished: int
    """Frames with fuel votes, the last result of a camera's nodes."""
    dropped: Mapping[str, int]
    """Drops by cause, of all its nodes; `shed`: rejected on arrival."""
    latency_s: float | None
    """Seconds from a frame's stamp to its last result, median of the slowest node."""
    pose: str
    """State of its newest pose; empty: poses are not checked."""
    wrong: str
    """Problem in words; empty: none."""


@dataclass(frozen=True)
class OutboxState:
    """Votes that the map of the region has not acknowledged yet."""

    frames: int
    bytes: int
    age_s: float
    """Age of the oldest in seconds, since its stamp; 0: none."""
    link_up: bool
    """Whether the broker and the region's map answer."""


@dataclass(frozen=True)
class TowerStatus:
    site: str
    time_s: float
    """Time by the system clock."""
    nodes: Sequence[NodeState]
    cameras: Sequence[CameraStatus]
    machine: Machine
    frame_limit_s: float
    outbox: OutboxState | None = None
    """None: the site belongs to no region, or its node `uplink` has not reported."""
    conditions: Sequence[Condition] = field(default_factory=tuple)
    """The most severe first."""

    @property
    def wrong(self) -> Sequence[str]:
        """Return the problems as sentences, the most severe first."""
        return [condition.problem for condition in self.conditions if condition.problem]

    @property
    def alive(self) -> bool:
        """Return whether every node reports: the answer of `/healthz`."""
        return all(node.state in ("ok", "warning") for node in self.nodes)

    @property
    def ready(self) -> bool:
        """Return whether every node reports and every camera sends: the answer of `/readyz`."""
        return self.alive and all(camera.state.sending for camera in self.cameras)

    def as_dict(self) -> dict[str, Any]:
        found: dict[str, Any] = asdict(self)
        machine: dict[str, Any] = found.pop("machine")
        return found | machine | {"alive": self.alive, "ready": self.ready, "wrong": self.wrong}


class TowerWatch:
    """Keeps the last report of each expected node; other reports are ignored.

    Args: site: its name. expected: full names of the graph's nodes, such as `/ridge/north/depth`. frame_limit_s: age in
    seconds from which a camera's newest frame is reported as too old."""

    def __init__(self, site: str, expected: Sequence[str], frame_limit_s: float) -> None:
        self._site, self._frame_limit_s = site, frame_limit_s
        self._expected = list(expected)
        self._reports: dict[str, tuple[NodeState, float]] = {}
        """Last report of each node, and its time by a monotonic clock."""
        self._states: dict[str, tuple[CameraState, float]] = {}
        """State of each camera, and its start by the system clock."""

    def hear(self, name: str, warning: bool, message: str, values: Mapping[str, str], now_s: float) -> None:
        if name in self._expected:
            kept = {key[:LENGTH]: value[:LENGTH] for key, value in list(values.items())[:KEYS]}
            state = "warning" if warning else "ok"
            self._reports[name] = NodeState(name, camera_of(name), state, message[:LENGTH], 0.0, kept), now_s

    def status(self, now_s: float, time_s: float, machine: Machine) -> TowerStatus:
        """Return the status. `now_s`: by the clock of `hear`; `time_s`: by the clock that stamps frames."""
        nodes = [self._node(name, now_s) for name in self._expected]
        cameras, outbox = self.cameras(now_s, time_s), self._outbox()
        conditions = tuple(_conditions(nodes, cameras, machine, outbox))
        return TowerStatus(self._site, time_s, nodes, cameras, machine, self._frame_limit_s, outbox, conditions)

    def cameras(self, now_s: float, time_s: float) -> list[CameraStatus]:
        """Return the state of each camera; clocks as for `status`."""
        return [self._camera(name, now_s, time_s) for name in dict.fromkeys(map(camera_of, self._expected)) if name]

    def _outbox(self) -> OutboxState | None:
        report = self._reports.get(f"/{self._site}/uplink")
        numbers = [report[0].number(key) for key in OUTBOX_KEYS] if report else [None]
        known = [number for number in numbers if number is not None]
        if len(known) < len(OUTBOX_KEYS):
            return None
        frames, size, age_s, link_up = known
        return OutboxState(int(frames), int(size), age_s, link_up > 0)

    def _node(self, name: str, now_s: float) -> NodeState:
        if name not in self._reports:
            return NodeState(name, camera_of(name), "missing", "no report yet", None, {})
        report, heard_s = self._reports[name]
        if (age_s := now_s - heard_s) > SILENT_S:
            return replace(report, state="silent", said=f"no report for {age_s:.0f} s", age_s=age_s)
        return replace(report, age_s=age_s)

    def _camera(self, name: str, now_s: float, time_s: float) -> CameraStatus:
        own = {r.name.rpartition("/")[2]: r for r, _ in self._reports.values() if r.camera == name}
        dropped: dict[str, int] = {}
        for report in own.values():
            for cause, count in report.counts("dropped.").items():
                dropped[cause] = dropped.get(cause, 0) + count
        capture, judge, votes = own.get("capture"), own.get("topodepth"), own.get("fuel_votes")
        stamp = capture.number("newest_stamp") if capture else None
        latencies = [ms for r in own.values() if (ms := r.number("latency_p50_ms")) is not None]
        pose = judge.values.get("verdict", "") if judge else ""
        if mount := (own["pose"].values.get("mount", "") if "pose" in own else ""):
            pose = f"{pose}; mount {mount}" if pose else f"mount {mount}"
        age_s = None if stamp is None else time_s - stamp
        state, why = self._state(name, now_s, age_s)
        wrong = (votes.values.get("reason.pose_contradicted") if votes else "") or ""
        if not state.sending:
            wrong = why or state
        elif not wrong and ("pose_suspected" in pose or "slipped" in pose):
            last = judge.values.get("last_verdict") if judge else ""
            wrong = f"the pose is uncertain{f' ({last})' if last else ''}; check whether the mount has moved"
        return CameraStatus(
            name=name,
            state=state,
            since_s=self._since(name, state, time_s),
            why=why,
            frame_age_s=age_s,
            frames_in=int(capture.number("frames_in") or 0) if capture else 0,
            finished=int(votes.number("frames_out") or 0) if votes else 0,
            dropped=dropped,
            latency_s=max(latencies) / 1000 if latencies else None,
            pose=pose,
            wrong=f"{name}: {wrong}" if wrong else "",
        )

    def _state(self, name: str, now_s: float, age_s: float | None) -> tuple[CameraState, str]:
        """Return the state of a camera and its reason. `age_s`: age of its newest frame; None: no frame."""
        place, state, why, limit_s = f"/{self._site}/{name}/source", CameraState.ALIVE, "", self._frame_limit_s
        if place in self._expected:
            node = self._node(place, now_s)
            stated = node.values.get("state", "")
            if node.state == "silent" or stated not in list(CameraState):
                return CameraState.STALLED if node.state == "silent" else CameraState.CONNECTING, f"source: {node.said}"
            state, why = CameraState(stated), node.values.get("state_why", "")
            limit_s = max(limit_s, node.number("stalled_after_s") or 0.0)
            if state.failing or state in (CameraState.CONNECTING, CameraState.NIGHT):
                return state, why or "no image yet" * (state is CameraState.CONNECTING)
        if age_s is None and (capture := self._node(f"/{self._site}/{name}/capture", now_s)).state == "warning":
            return CameraState.CONNECTING, f"capture: {capture.said}"
        if age_s is None:
            why = "no frame since the start; check that the camera is on and publishes to its topics"
            return CameraState.CONNECTING, why
        if age_s > limit_s:
            return CameraState.STALLED, f"no new frame for {_time(age_s)}{f' ({why})' if why else ''}"
        if age_s < -limit_s:
            return CameraState.STALLED, f"the camera's clock is {_time(-age_s)} ahead of the system clock"
        return state, why

    def _since(self, name: str, state: CameraState, time_s: float) -> float:
        known, since_s = self._states.get(name, (None, -math.inf))
        if known is not state:
            source = self._reports.get(f"/{self._site}/{name}/source")
            own = source[0].number("state_since") if source and source[0].values.get("state") == state else None
            since_s = own if own is not None and max(since_s, 0.0) < own <= time_s else time_s
            self._states[name] = state, since_s
        return since_s


def camera_of(name: str) -> str:
    """Return the camera of a node's full name, `/ridge/north/depth`; empty for a node of the site."""
    parts = name.strip("/").split("/")
    return parts[1] if len(parts) > 2 else ""


def _conditions(
    nodes: Sequence[NodeState], cameras: Sequence[CameraStatus], machine: Machine, outbox: OutboxState | None
) -> Iterator[Condition]:
    """Yield the conditions, the most severe first."""
    told = {f"{camera.name}/source" for camera in cameras if camera.wrong}
    warnings = []
    for node in nodes:
        name = node.name.split("/", 2)[-1]
        if node.state == "warning" and name not in told:
            warnings.append(Condition("node", name, node.state, f"{node.name}: {node.said}"))
        else:
            dead = node.state in ("silent", "missing")
            yield Condition.judged("node", name, node.state, f"{node.name} {node.said}" if dead else "")
    for camera in cameras:
        sending = camera.state.sending
        yield Condition("camera", camera.name, camera.state, "" if sending else camera.wrong)
        if sending:
            yield Condition.judged("pose", camera.name, "uncertain", camera.wrong)
    yield from machine.conditions()
    if outbox is not None:
        problem = (
            f"no connection to the region's map: {outbox.frames} frames are queued in the outbox, the oldest for "
            f"{_time(outbox.age_s)}"
        )
        yield Condition.judged("outbox", "region", "waiting", problem if outbox.frames and not outbox.link_up else "")
    yield from warnings


def _time(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
