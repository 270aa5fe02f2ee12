"""Subscription callbacks that also get what the middleware says of a message, under every executor."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any


def with_info(take: Callable[[Any, Any], None]) -> Callable[..., None]:
    """`take` as `create_subscription` shall have it.

    rclpy finds out from a callback's signature whether it wants the info, and calls it with both; its EventsExecutor,
    as of 7.1, with one tuple of both.
    """

    def callback(*given: Any) -> None:
        message, info = given if len(given) == 2 else given[0]
        take(message, info)

    callback.__signature__ = inspect.signature(lambda message, info: None)  # type: ignore[attr-defined]
    return callback
