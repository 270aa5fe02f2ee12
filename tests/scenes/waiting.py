"""Waiting for a condition, never for a time: tests neither hurry a busy machine nor idle on a quiet one."""

from __future__ import annotations

import time
from collections.abc import Callable

PATIENCE_S = 60.0


def wait_for(
    condition: Callable[[], object], what: str, state: Callable[[], object] = lambda: "", patience_s: float = PATIENCE_S
) -> None:
    """Until `condition` holds. Fails with `what` was awaited and the `state` of things."""
    deadline = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < deadline, f"waited {patience_s} s for {what}; {state()}"
        time.sleep(0.02)
