"""Run a tower's side of the link: votes of its cameras go into the outbox, and from there to the region's map.

A frame leaves the outbox only after the aggregator's signed acknowledgement, and is sent again after any failure."""

import os
import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Final

from pydantic import ValidationError

from ltm_core.base.errors import MessageError, StoreError
from ltm_core.uplink.config import AGGREGATOR, UplinkConfig
from ltm_core.uplink.envelope import VERSION, AckHeader, Outcome, VotesGrid, VotesHeader, header_of, outcomes_of
from ltm_core.uplink.outbox_io import FrameKey, Outbox, OutboxFrame
from ltm_ros.region.identity import Identity
from ltm_ros.region.mqtt_link import MqttLink, ack_topic, presence_topic, votes_topic
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.heartbeat import HEARTBEAT
from ltm_ros.runtime.retry import LAST_TRIES_S, Backoff

WINDOW: Final = 64
"""Maximum number of frames in flight, and"""
WINDOW_BYTES: Final = 1 << 20
"""their maximum bytes."""
RESEND_S: Final = 30.0
"""Seconds after which an unacknowledged frame is sent again although the aggregator seems present; doubled each time,
up to"""
LONGEST_RESEND_S: Final = 480.0
REFUSED_PAUSE_S: Final = 600.0
"""Seconds until a frame that the aggregator rejected is sent again: a version, a clock or a list of towers may be
corrected."""
OPEN_S: Final = 5.0
"""Seconds between two attempts to open an outbox whose disk fails."""
SLOW_S: Final = 1.0
"""Seconds for one transaction above which a warning is given: the disk may be failing, or overloaded."""
HELD_BYTES: Final = 32 << 20
"""Maximum bytes of frames that wait for a failing disk; further ones are lost, and counted."""
BOUND_S: Final = 10.0
"""Seconds between two checks of the outbox's age and size limits."""
STEP_S: Final = 0.2

Clock = Callable[[], int | None]
"""Time in ns; None: the system clock is not synchronised, so frames have no age."""


class TowerLink:
    """`offer` takes frames from any thread; a separate thread stores and sends them. `grid`: the fuel grid of the
    votes. `clock`: for the age of frames."""

    def __init__(self, config: UplinkConfig, grid: VotesGrid, outbox: Path, health: Health, clock: Clock) -> None:
        """Open the link. Raises ConfigError for an invalid certificate, key or outbox. If its disk fails, frames wait
        in memory, and it is tried again."""
        self._config, self._grid, self._health, self._clock = config, grid, health, clock
        self._identity = Identity(config.broker, config.tower)
        self._file = outbox
        self._outbox: Outbox | None = None
        self._open_due = 0.0
        self._offered: deque[OutboxFrame] = deque()
        self._held = 0
        self._lock = threading.Lock()
        self._acks: queue.Queue[bytes] = queue.Queue(1000)
        self._presence = ""
        """Run number of the active aggregator; empty: none."""
        self._answered_by: tuple[str, int] = ("", 0)
        """The aggregator run to which the frames in flight were sent, and the connection."""
        self._on_their_way: dict[FrameKey, tuple[float, int]] = {}
        """Time at which each is sent again, and its bytes."""
        self._answered: set[FrameKey] = set()
        """Acknowledged frames that are not yet deleted from the disk: they are not sent again."""
        self._resend = Backoff(RESEND_S, LONGEST_RESEND_S)
        self._bound_due = 0.0
        self._wake, self._stopping = threading.Event(), threading.Event()
        topics = [ack_topic(config.name, config.tower), presence_topic(config.name)]
        name = f"{config.name}-{config.tower}"
        self._link = MqttLink(config.broker, self._identity, name, topics, self._take, health)
        try:
            self._open()
        except StoreError as error:
            health.trouble(cause_of(error), str(error))
        self._activity = HEARTBEAT.activity("uplink")
        self._thread = threading.Thread(target=self._run, name="uplink", daemon=True)

    def start(self) -> None:
        self._link.start()
        self._thread.start()

    def offer(self, frame: OutboxFrame) -> None:
        """Queue a frame for the region; it is in the outbox shortly after."""
        with self._lock:
            if self._held + len(frame.message) > HELD_BYTES:
                self._health.drop(
                    "outbox_full", f"the outbox's disk has failed for {HELD_BYTES >> 20} MB of frames; check it"
                )
                return
            self._held += len(frame.message)
            self._offered.append(frame)
        self._wake.set()

    def stop(self) -> bool:
        """Write the queued frames and close the outbox; False: some frames could not be written, and are lost."""
        self._stopping.set()
        self._wake.set()
        self._thread.join(LAST_TRIES_S + 2.0)
        if lost := len(self._offered):
            self._health.drop("outbox_full", f"{lost} frames could not be written before the end", lost)
        self._link.stop()
        if self._outbox is not None:
            self._outbox.close()
        return not lost

    def step(self, now_s: float) -> None:
        """Run one turn of the thread's work. Raises StoreError if the disk fails; frames in the outbox are still sent,
        because deleting them frees space on a full disk."""
        if self._outbox is None and (now_s >= self._open_due or self._stopping.is_set()):
            self._open_due = now_s + OPEN_S
            try:
                self._open()
            finally:
                self._state()
        if (outbox := self._outbox) is None:
            return
        try:
            self._keep(outbox)
        finally:
            self._hear_acks(outbox, now_s)
            if now_s >= self._bound_due or outbox.bytes > self._config.outbox_bytes:
                self._bound_due = now_s + BOUND_S
                self._bound(outbox)
            self._send(outbox, now_s)
            self._state()

    def _open(self) -> None:
        self._outbox = Outbox(self._file, self._config.outbox_bytes, self._config.outbox_days * 86_400)
        if self._outbox.damage:
            self._health.drop("outbox_damaged", self._outbox.damage)

    def _run(self) -> None:
        stop_at = 0.0
        while True:
            self._wake.wait(STEP_S)
            self._wake.clear()
            try:
                with self._activity.turn("outbox", slow=True):
                    self.step(time.monotonic())
            except StoreError as error:
                self._health.trouble(cause_of(error), str(error))
                time.sleep(STEP_S)
            except BaseException:
                # An internal error, or a damaged outbox: an uplink that sends nothing must not look healthy; the
                # graph restarts it.
                sys.excepthook(*sys.exc_info())
                os._exit(1)
            if self._stopping.is_set():
                stop_at = stop_at or time.monotonic() + LAST_TRIES_S
                if not self._offered or time.monotonic() > stop_at:
                    return

    def _keep(self, outbox: Outbox) -> None:
        with self._lock:
            frames = list(self._offered)
        if not frames:
            return
        begun = time.monotonic()
        outbox.put(frames)
        if (took := time.monotonic() - begun) > SLOW_S:
            words = "check its health (smartctl), and what else writes to it"
            self._health.trouble("outbox_slow", f"the disk took {took:.1f} s to store {len(frames)} frames: {words}")
        with self._lock:
            for frame in frames:
                self._offered.popleft()
                self._held -= len(frame.message)

    def _hear_acks(self, outbox: Outbox, now_s: float) -> None:
        refused: list[FrameKey] = []
        for _ in range(self._acks.qsize()):  # not until it is empty, because it may be filled as quickly
            for outcome in self._outcomes(self._acks.get_nowait()):
                key = outcome.camera, outcome.stamp_ns
                self._on_their_way.pop(key, None)
                if outcome.done:
                    self._answered.add(key)
                else:
                    refused.append(key)
                    self._health.note("refused")
                    self._health.trouble(
                        "refused", f"the region's map rejected the frame {key[1]} of {key[0]}: {outcome.why}"
                    )
        if refused:
            outbox.postpone(refused, now_s + REFUSED_PAUSE_S)
        if self._answered:
            self._resend.succeeded()
            for _ in range(outbox.acknowledge(self._answered)):
                self._health.note("acknowledged")
            self._answered.clear()

    def _outcomes(self, content: bytes) -> list[Outcome]:
        """Return the outcomes of an acknowledgement by the aggregator for this tower; invalid ones are counted."""
        here = self._config.name, self._config.tower, VERSION
        try:
            envelope = self._identity.opened(content, AGGREGATOR)
            header = header_of(AckHeader, envelope)
            if (found := (header.region, header.tower, header.version)) != here:
                raise MessageError(f"an acknowledgement is for region, tower and version {found}; this is {here}")
            return outcomes_of(envelope)
        except MessageError as error:
            self._health.drop(cause_of(error), str(error))
            return []

    def _bound(self, outbox: Outbox) -> None:
        aged, thinned = outbox.bound(self._clock())
        if aged:
            words = f"frames older than {self._config.outbox_days:g} days were not sent; check the link"
            self._health.drop("outbox_aged", words, aged)
        if thinned:
            self._health.drop(
                "outbox_thinned",
                f"more than {self._config.outbox_bytes >> 20} MB were queued for the link: every other frame of "
                "each view was deleted, the oldest first",
                thinned,
            )

    def _send(self, outbox: Outbox, now_s: float) -> None:
        life = self._presence, self._link.connections
        if not (life[0] and self._link.connected.is_set()):
            return
        if life != self._answered_by:
            # What a previous aggregator run had in memory is lost, and so is what was in flight on the connection.
            self._answered_by = life
            self._on_their_way.clear()
        late = [key for key, (again, _) in self._on_their_way.items() if now_s >= again]
        if late:
            self._health.note("sent_again")
            self._resend.failed()
            for key in late:
                del self._on_their_way[key]
        frames, room = WINDOW - len(self._on_their_way), WINDOW_BYTES - sum(n for _, n in self._on_their_way.values())
        if frames <= 0 or room <= 0 or not outbox.frames:
            return
        for key, size in outbox.waiting(frames, now_s, self._on_their_way):
            if size > room and self._on_their_way:
                return
            if (frame := outbox.frame(key)) is None:
                continue
            try:
                header = VotesHeader(
                    region=self._config.name,
                    tower=self._config.tower,
                    camera=frame.camera,
                    stamp_ns=frame.stamp_ns,
                    model=frame.model,
                    grid=self._grid,
                )
                content = self._identity.sealed(header.model_dump_json().encode(), frame.message)
            except (MessageError, ValidationError) as error:
                outbox.acknowledge([key])
                self._health.drop("message", f"the frame {frame.stamp_ns} of {frame.camera} cannot be sent: {error}")
                continue
            if not self._link.send(votes_topic(self._config.name, self._config.tower), content):
                return
            self._on_their_way[key] = now_s + self._resend.pause_s, size
            room -= size

    def _state(self) -> None:
        """Report the frames in the outbox, or in memory while its disk fails."""
        if (outbox := self._outbox) is not None:
            frames, size, oldest = outbox.frames, outbox.bytes, outbox.oldest_ns()
        else:
            with self._lock:
                frames, size = len(self._offered), self._held
                oldest = min((frame.stamp_ns for frame in self._offered), default=None)
        now_ns = self._clock() or time.time_ns()
        age_s = 0.0 if oldest is None else max(0.0, (now_ns - oldest) / 1e9)
        self._health.gauge("outbox_frames", frames)
        self._health.gauge("outbox_bytes", size)
        self._health.gauge("outbox_age_s", f"{age_s:.1f}")
        self._health.gauge("link_up", int(bool(self._presence and self._link.connected.is_set())))

    def _take(self, topic: str, payload: bytes) -> None:
        """Receive a message in the connection's thread."""
        if topic == presence_topic(self._config.name):
            self._presence = payload[:64].decode("ascii", "replace")
        else:
            try:
                self._acks.put_nowait(payload)
            except queue.Full:
                self._health.drop("overload", "too many acknowledgements; they are requested again")
        self._wake.set()
