"""Waiting for a condition, never for a time: tests neither hurry a busy machine nor idle on a quiet one."""

import time
from collections.abc import Callable

PATIENCE_S = 120.0


def wait_for(
    condition: Callable[[], object], what: str, state: Callable[[], object] = lambda: "", patience_s: float = PATIENCE_S
) -> None:
    """Until `condition` holds. Fails with `what` was awaited and the `state` of things.

    Who has waited for long looks less often: what is awaited then, nodes that start, needs the core that looking takes.
    """
    since = time.monotonic()
    while not condition():
        waited = time.monotonic() - since
        assert waited < patience_s, f"waited {patience_s} s for {what}; {state()}"
        time.sleep(min(0.02 + 0.05 * waited, 0.2))
