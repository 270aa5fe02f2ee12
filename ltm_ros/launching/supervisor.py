"""Supervise one process of a graph: start it, label its output, restart it with back-off when it dies or hangs."""

import contextlib
import os
import select
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import IO

from ltm_core.site.sections import WatchdogConfig
from ltm_ros.launching.supervised import SHOW_STACKS, start_supervised
from ltm_ros.launching.watchdog import HangWatch, process_use
from ltm_ros.runtime.handler import EX_CONFIG
from ltm_ros.runtime.retry import Backoff

LOOK_S = 1.0
UNWATCHED_S = 60.0
"""Seconds after which a supervisor that has not checked its process counts as hung."""
STACKS_S = 1.0
"""Seconds for a hung process to print its stacks before it is killed."""

Console = Callable[[str], None]


@dataclass(frozen=True)
class RestartPolicy:
    """Restart delays of a dead node: `initial_s`, then doubled each time up to `maximum_s`."""

    initial_s: float = 0.5
    maximum_s: float = 30.0
    healthy_s: float = 20.0
    """Run time in seconds after which the back-off starts again."""
    config_tries: int = 3
    """Number of consecutive exits with EX_CONFIG after which the node counts as failing."""


def describe_exit(status: int) -> str:
    """Return an exit status in words: the signal's name, or what the code means."""
    if status < 0:
        with contextlib.suppress(ValueError):
            return f"killed by {signal.Signals(-status).name}"
        return f"killed by signal {-status}"
    meaning = {EX_CONFIG: ": its configuration is invalid", 0: ", a normal end"}
    return f"exit code {status}{meaning.get(status, '')}"


def _end_group(group: int) -> None:
    """End what a process has started and left: SIGTERM, SIGKILL a second later; return when all have ended, or after
    another second."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        deadline = time.monotonic() + 1.0
        try:
            os.killpg(group, number)
            while time.monotonic() < deadline:
                time.sleep(0.02)
                os.killpg(group, 0)
        except (ProcessLookupError, PermissionError):
            return


@dataclass
class NodeProcess:
    """Runs `command`, a `supervised_command`, until `stop`; one thread follows the process, another its output. A hung
    process is killed with all its children and restarted."""

    label: str
    command: Sequence[str]
    environment: Mapping[str, str]
    console: Console
    policy: RestartPolicy = field(default_factory=RestartPolicy)
    watchdog: WatchdogConfig = field(default_factory=WatchdogConfig)
    """Limits after which it counts as hung."""
    on_end: Callable[[], object] = lambda: None
    """Called when the process has ended: each crash leaves 70 MB of shared memory."""

    pid: int | None = field(default=None, init=False)
    ready: frozenset[str] = field(default=frozenset(), init=False)
    """Full names of its nodes that have sent a diagnostic in this run."""
    starts: int = field(default=0, init=False)
    hangs: int = field(default=0, init=False)
    """Number of times it was killed because it hung."""
    last_exit: str = field(default="", init=False)
    """End of the last run, in words."""
    config_errors: int = field(default=0, init=False)
    """Number of consecutive exits with EX_CONFIG, none after a long run."""

    def __post_init__(self) -> None:
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self.last_words = deque[str](maxlen=12)
        """The newest lines of its output."""
        self._slow_starts = 0
        self._look_due = time.monotonic()
        self._hang = ""
        """Reason why the last run was killed as hung, if it was."""
        self._thread = threading.Thread(target=self._supervise, name=f"supervise {self.label}", daemon=True)

    @property
    def running(self) -> bool:
        return self.pid is not None

    @property
    def failing(self) -> bool:
        """Return whether its configuration was invalid at several starts in a row. It is started again nevertheless,
        because what it lacks may come back: a disk, or a file."""
        return self.config_errors >= self.policy.config_tries and not self.ready

    @property
    def watched(self) -> bool:
        """Return whether its supervisor works, or need not. False if it hangs (blocked console) or has died."""
        works = self._thread.is_alive() and time.monotonic() - self._look_due < UNWATCHED_S
        return works or self._stopping.is_set()

    def start(self) -> None:
        self._look_due = time.monotonic()
        self._thread.start()

    def signal(self, number: int, *, whole_group: bool = False) -> bool:
        """Send a signal to the node (or all its children). Returns False if it does not run."""
        # Under the lock the process is not reaped yet, so its id is still valid.
        with self._lock:
            if self.pid is None:
                return False
            (os.killpg if whole_group else os.kill)(self.pid, number)
            return True

    def request_stop(self) -> None:
        """Disable restarts; the running process is not affected."""
        self._stopping.set()

    def wait_stopped(self, timeout_s: float) -> bool:
        """Return whether it has stopped for good within `timeout_s`; call it after `request_stop`."""
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _supervise(self) -> None:
        backoff = Backoff(self.policy.initial_s, self.policy.maximum_s)
        while not self._stopping.is_set():
            begun = time.monotonic()
            status = self._run_once()
            uptime_s = time.monotonic() - begun
            if self._stopping.is_set():
                return
            self.last_exit = f"hung ({self._hang})" if self._hang else describe_exit(status)
            if uptime_s >= self.policy.healthy_s:
                backoff.succeeded()
                self.config_errors = 0
            self.config_errors = self.config_errors + 1 if status == EX_CONFIG else 0
            delay_s = backoff.failed()
            self._tell(f"{self.last_exit} after {uptime_s:.1f} s; restarting in {delay_s:.1f} s")
            self._look_due = time.monotonic() + delay_s
            self._stopping.wait(delay_s)

    def _run_once(self) -> int:
        """Start the process and wait for its end; return its exit status as subprocess does."""
        try:
            process, heartbeat = start_supervised(self.command, self.environment)
        except OSError as error:
            self._tell(f"cannot be started: {error}")
            return 127
        group = process.pid
        with self._lock:
            self.pid = process.pid
            self.starts += 1
        self._tell(f"started as process {process.pid}")
        assert process.stdout is not None  # nosec B101 # tells the type checker what holds
        reader = threading.Thread(target=self._read, args=(process.stdout,), name=f"read {self.label}", daemon=True)
        reader.start()
        self._hang = self._follow(process.pid, heartbeat)
        with self._lock:
            self.pid = None
            status = process.wait()
        _end_group(group)
        self.on_end()
        reader.join(timeout=2.0)
        return status

    def _follow(self, pid: int, heartbeat: int) -> str:
        """Wait until the process has ended; return why it was killed, if it hung. It is not reaped here, so that its
        process id cannot be reused."""
        watch = HangWatch(self.watchdog, self._slow_starts)
        hang = ""
        end = os.pidfd_open(pid)
        poll = select.poll()
        poll.register(end, select.POLLIN)
        poll.register(heartbeat, select.POLLIN)
        last = time.monotonic()
        try:
            while True:
                ready = dict(poll.poll(LOOK_S * 1000))
                if end in ready:
                    break
                heard = b""
                if heartbeat in ready and not (heard := os.read(heartbeat, 1 << 16)):
                    poll.unregister(heartbeat)
                now = time.monotonic()
                elapsed_s, last = now - last, now
                self._look_due = now
                if not hang and (hang := watch.look(elapsed_s, heard, process_use(pid))):
                    self._kill_hung(hang, end)
                self.ready = watch.ready
        finally:
            os.close(end)
            os.close(heartbeat)
        self.ready = frozenset()
        self._slow_starts = self._slow_starts + 1 if hang and not watch.started else 0
        return hang

    def _kill_hung(self, hang: str, end: int) -> None:
        self.hangs += 1
        ended = select.poll()
        ended.register(end, select.POLLIN)
        # A stopped process sends nothing, and one that is still starting `supervised` dies of this signal.
        self.signal(SHOW_STACKS)
        ended.poll(STACKS_S * 1000)
        self.signal(signal.SIGKILL, whole_group=True)
        self._tell(f"hung: {hang}; killed (hang {self.hangs})")

    def _read(self, output: IO[str]) -> None:
        with output:
            for line in output:
                self.last_words.append(line.rstrip("\n"))
                self._emit(line.rstrip("\n"))

    def _tell(self, text: str) -> None:
        self._emit(f"-- {text}")

    def _emit(self, line: str) -> None:
        self.console(f"[{self.label}] {line}")
