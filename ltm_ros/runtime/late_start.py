"""Makes, while all else is at work, what could not be made at the start."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

from ltm_core.base.errors import LtmError
from ltm_ros.runtime.retry import Backoff

LONGEST_PAUSE_S = 120.0
"""Between two attempts: each reads what it needs anew."""

MadeT = TypeVar("MadeT")


def _on_thread(work: Callable[[], None]) -> threading.Thread:
    thread = threading.Thread(target=work, name="late start", daemon=True)
    thread.start()
    return thread


class LateStart(Generic[MadeT]):
    """Tries each of `makes` now and then until it succeeds, one at a time, on a thread that nobody waits for.

    Args:
        makes: by name. What one raises is said, once for each new reason, and it is tried again.
        said: why each could not be made before, by name.
        say: takes a line.
        start: runs an attempt; an argument for tests.
    """

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
        """So many seconds have passed; what has been made since the last call."""
        made = self._take()
        for pace in self._paces.values():
            pace.passed(waited)
        due = next((name for name in self._makes if self._paces[name].due), None)
        if due is not None and not self._busy and not self._closed:
            # Whoever comes next waits behind those that are tried less often by now.
            self._makes[due] = self._makes.pop(due)
            self._paces[due].failed()
            self._attempt = self._start(lambda: self._try(due))
        return made + self._take()

    def close(self, patience_s: float) -> list[MadeT]:
        """Begin no further attempt and wait for one that is under way; what was made and nobody has taken."""
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
        """Whether this is a new reason."""
        new = self._said.get(name) != why
        self._said[name] = why
        if new:
            self._say(cannot_start(name, why))
        return new


def cannot_start(name: str, why: str) -> str:
    return f"{name}: cannot start: {why}; it is tried again"
