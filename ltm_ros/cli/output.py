"""Check output paths, show progress, and print tables."""

from __future__ import annotations

import math
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_core.storage.disk_io import require_files, require_folder

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import ProgressColumn
    from rich.table import Table

    from ltm_core.raster.dem import Dem
    from ltm_ros.runtime.health import NodeRow


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str] | None]) -> Table:
    """Return a table for a terminal. Cells may hold markup; escape text that others wrote.

    Args:
        title: above the table; "" for none.
        columns: their names; a name that begins with ">" makes its column right-aligned and never wrapped. If all names
            are empty, the table has no header.
        rows: the cells of each row; None draws a line between two rows."""
    from rich.table import Table

    made = Table(title=title or None, title_justify="left", show_header=any(columns))
    for name in columns:
        number = name.startswith(">")
        made.add_column(name.removeprefix(">"), justify="right" if number else "left", no_wrap=number, overflow="fold")
    for row in rows:
        if row is None:
            made.add_section()
        else:
            made.add_row(*row)
    return made


def open_dems(rasters: Sequence[Path], crs: str | None) -> Dem:
    """Open the terrain of `--dem`, finest first, and print what may be wrong with it. `crs`: of the first."""
    from ltm_core.raster.dem_stack import open_terrain

    return print_doubts(open_terrain([(rasters[0], crs), *((raster, None) for raster in rasters[1:])]))


def print_doubts(dem: Dem) -> Dem:
    """Print to stderr what may be wrong with a terrain; return it."""
    from rich.console import Console
    from rich.markup import escape

    for doubt in dem.doubts:
        Console(stderr=True).print(f"[yellow]{escape(doubt.text)}", highlight=False)
    return dem


def print_table(console: Console, title: str, columns: Sequence[str], rows: Iterable[Sequence[str] | None]) -> None:
    """Print a table; see `table`."""
    console.print(table(title, columns, rows))


def print_findings(console: Console, rows: Iterable[tuple[str, str, str, str, str]]) -> None:
    """Print the results of checks, by area: area, state, the state's style, what was checked, what was found."""
    from rich.markup import escape

    cells: list[Sequence[str] | None] = []
    last = ""
    for area, state, style, name, found in rows:
        if area != last:
            cells.append(None)
        cells.append((escape(area) if area != last else "", f"[{style}]{state}[/]", escape(name), escape(found)))
        last = area
    print_table(console, "", ("", "", "what", "found"), cells)


@contextmanager
def message_bar(console: Console, what: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar over messages; yields `update(done, total)`. A full bar starts again, for loops."""
    from rich.progress import Progress

    with Progress(*_columns(), console=console) as bar:
        task = bar.add_task(f"{what}: starting the graph", total=None)

        def update(done: int, total: int) -> None:
            place = (done - 1) % total + 1
            description = f"{what}: waiting for its results" if done == total else what
            bar.update(task, completed=place, total=total, description=description)

        yield update


@contextmanager
def counting_bar(console: Console, what: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar over items, with the remaining time; yields `update(done, total)`."""
    from rich.progress import Progress, TimeRemainingColumn

    with Progress(*_columns(), TimeRemainingColumn(), console=console) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _columns() -> tuple[ProgressColumn, ...]:
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

    return TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()


@contextmanager
def stop_on_signals(event: threading.Event) -> Iterator[None]:
    """Set the event on SIGINT and SIGTERM instead of ending the process, within the context."""
    before = {number: signal.signal(number, lambda *_: event.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


Overwrite = Annotated[bool, typer.Option("--overwrite", help="Overwrite existing files.")]


def writable_file(path: Path | None) -> Path | None:
    """Check an option that names a file, which may exist. Raises ConfigError."""
    if path is not None:
        require_files([path])
    return path


def writable_folder(path: Path | None) -> Path | None:
    """Check an option that names a folder. Raises ConfigError."""
    if path is not None:
        require_folder(path)
    return path


JsonFile = Annotated[
    Path | None, typer.Option("--json", help="Also write all figures to this file.", callback=writable_file)
]


def print_nodes(console: Console, rows: Sequence[NodeRow]) -> None:
    """Print messages in and out, drops by cause with an example of each, and latency since capture."""
    from rich.markup import escape

    columns = ["node", ">in", ">out", ">drops", ">p50 ms", ">p95 ms", ">work ms"]
    if any(row.causes for row in rows):
        columns.append("dropped because")
    cells = []
    for row in rows:
        times = (row.latency_p50_ms, row.latency_p95_ms, row.work_p50_ms)
        shown = ["" if math.isnan(t) else f"{t:.0f}" for t in times]
        drops = f"[red]{row.dropped}[/red]" if row.dropped else "0"
        causes = [row.causes] if row.causes else []
        cells.append((_short(row), str(row.received), str(row.published), drops, *shown, *causes))
    print_table(console, "nodes: frames and latency", columns, cells)
    for row in rows:
        for reason in row.reasons:
            console.print(f"[red]{escape(_short(row))}[/red] dropped by {escape(reason)}", highlight=False)
    console.print("in, out: frames; p50, p95: latency since capture; work: median time in the node")


def print_outcome(console: Console, summaries: Mapping[str, Mapping[str, str]]) -> None:
    """Print the results of a replay: verdicts on depth, cells seen and changed, events. `print_nodes` prints what
    was dropped."""
    from rich.markup import escape

    said = outcome(summaries)
    if not said:
        return
    rows = ((what, escape(how_much)) for what, how_much in said)  # reasons may hold brackets
    print_table(console, "results", ("", ""), rows)


def outcome(summaries: Mapping[str, Mapping[str, str]]) -> list[tuple[str, str]]:
    """Return rows (what, how much) from the key -> value texts of the nodes' diagnostics."""
    rows = []
    for name, summary in sorted(summaries.items()):
        node = "/".join(name.split("/")[2:]) or name
        verdicts = _counts(summary, "noted.verdict.")
        if verdicts:  # no shares: without subscribers only some frames are judged
            rows.append((f"{node}: verdicts", ", ".join(f"{verdict} {n}" for verdict, n in verdicts.items())))
            if "last_verdict" in summary:
                rows.append((f"{node}: the last that was not ok", summary["last_verdict"]))
        cells = _counts(summary, "cells.")
        if cells:
            rows.append((f"{node}: cells", ", ".join(f"{what} {n:,}" for what, n in cells.items())))
        events = {k: n for k, n in _counts(summary, "noted.").items() if not k.startswith("verdict.")}
        if events:
            rows.append((f"{node}: events", ", ".join(f"{event} {n:,}" for event, n in events.items())))
    return rows


def _counts(summary: Mapping[str, str], prefix: str) -> dict[str, int]:
    return {key.removeprefix(prefix): int(value) for key, value in summary.items() if key.startswith(prefix)}


def _short(row: NodeRow) -> str:
    return "/".join(row.node.split("/")[2:]) or row.node
