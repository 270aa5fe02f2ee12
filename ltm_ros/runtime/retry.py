"""Compute the pauses between failing attempts, and start later what cannot start yet."""

from __future__ import annotations

import random
import sys
import threading
from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

from ltm_core.base.errors import LtmError

FIRST_RETRY_S = 2.0
"""Default pause after the first failure."""
LONGEST_RETRY_S = 15.0
"""Default upper limit of the pause."""
LAST_TRIES_S = 3.0
"""Time for which a node that is stopping tries to write its data; it is killed after ten seconds."""
LAST_PAUSE_S = 0.25
"""Pause between these last attempts."""


class Backoff:
    """Double the pause with each failure in a row, from `first_s` up to `longest_s`.

    Sleep for what `failed` returns; or, without a clock, count time with `passed` and try again once it is `due`.

    Args:
        jitter: shortens each pause by up to half, but not below `first_s`, so that many clients do not retry together.
    """

    def __init__(
        self, first_s: float = FIRST_RETRY_S, longest_s: float = LONGEST_RETRY_S, jitter: random.Random | None = None
    ) -> None:
        self._first_s, self._longest_s, self._jitter = first_s, longest_s, jitter
        self.pause_s = first_s
        """Pause after the next failure, before jitter, seconds."""
        self._left_s = 0.0

    @property
    def due(self) -> bool:
        """Return whether the next attempt may be made."""
        return self._left_s <= 0.0

    def passed(self, seconds: float) -> None:
        self._left_s -= seconds

    def failed(self) -> float:
        """Return the pause before the next attempt, seconds."""
        pause_s = self.pause_s
        if self._jitter is not None:
            pause_s = max(self._first_s, pause_s * self._jitter.uniform(0.5, 1.0))
        self.pause_s = min(2 * self.pause_s, self._longest_s)
        self._left_s = pause_s
        return pause_s

    def succeeded(self) -> None:
        self._left_s, self.pause_s = 0.0, self._first_s


LONGEST_PAUSE_S = 120.0
"""Longest pause in seconds between two attempts, which read everything again."""

MadeT = TypeVar("MadeT")


def _on_thread(work: Callable[[], None]) -> threading.Thread:
    thread = threading.Thread(target=work, name="late start", daemon=True)
    thread.start()
    return thread


class LateStart(Generic[MadeT]):
    """Tries each of `makes` repeatedly until it succeeds, one at a time, on a background thread.

    Args: makes: by name. Errors are reported once for each new reason, and the attempt is repeated. said: why each
    could not be created before, by name. say: takes a line. start: runs an attempt; an argument for tests."""

    def __init__(
        self,
        makes: Mapping[str, Callable[[], MadeT]],
        said: Mapping[str, str],
        say: Callable[[str], None],
        start: Callable[[Callable[[], None]], threading.Thread | None] = _on_thread,
    ) -> None:
        self._makes, self._say, self._start = dict(makes), say, start
        self._said = dict(said)
        self._paces = {name: Backoff(longest_s=LONGEST_PAUSE_S) for name in makes}
        for pace in self._paces.values():
            pace.failed()
        self._attempt: threading.Thread | None = None
        self._made: dict[str, MadeT] = {}
        self._lock = threading.Lock()
        self._closed = False

    def tick(self, waited: float) -> list[MadeT]:
        """Advance time; return what was created since the last call."""
        made = self._take()
        for pace in self._paces.values():
            pace.passed(waited)
        due = next((name for name in self._makes if self._paces[name].due), None)
        if due is not None and not self._busy and not self._closed:
            # New ones wait behind those that are tried less often by now.
            self._makes[due] = self._makes.pop(due)
            self._paces[due].failed()
            self._attempt = self._start(lambda: self._try(due))
        return made + self._take()

    def close(self, patience_s: float) -> list[MadeT]:
        """Start no further attempt and wait for the current one; return results that were not taken."""
        self._closed = True
        if self._attempt is not None:
            self._attempt.join(patience_s)
        return self._take()

    @property
    def _busy(self) -> bool:
        return self._attempt is not None and self._attempt.is_alive()

    def _take(self) -> list[MadeT]:
        with self._lock:
            taken, self._made = self._made, {}
        for name in taken:
            del self._makes[name], self._paces[name]
        return list(taken.values())

    def _try(self, name: str) -> None:
        try:
            made = self._makes[name]()
        except LtmError as error:
            self._tell(name, str(error))
        except Exception as error:
            if self._tell(name, repr(error)):
                sys.excepthook(*sys.exc_info())
        else:
            with self._lock:
                self._made[name] = made
            self._say(f"{name}: started")

    def _tell(self, name: str, why: str) -> bool:
        """Return whether this is a new reason."""
        new = self._said.get(name) != why
        self._said[name] = why
        if new:
            self._say(cannot_start(name, why))
        return new


def cannot_start(name: str, why: str) -> str:
    return f"{name}: cannot start: {why}; retrying later"
