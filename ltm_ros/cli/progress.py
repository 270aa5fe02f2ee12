"""Progress bars and clean interruption for long commands."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


@contextmanager
def message_bar(console: Console, what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar over messages; yields `update(done, total)`. A bar that is full starts over, as a loop does."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(f"{what}: starting the graph", total=None)

        def update(done: int, total: int) -> None:
            place = (done - 1) % total + 1
            description = f"{what}: waiting for its results" if done == total else what
            bar.update(task, completed=place, total=total, description=description)

        yield update


@contextmanager
def counting_bar(console: Console, what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar over things that are done one by one, with the time that is left; yields `update(done, total)`."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def stop_on_signals(event: threading.Event) -> Iterator[None]:
    """Within it, SIGINT and SIGTERM set the event instead of ending the process."""
    before = {number: signal.signal(number, lambda *_: event.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
