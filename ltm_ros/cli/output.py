"""Options that commands share, and what they print: lines, tables and progress."""

import math
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from ltm_core.base.errors import ConfigError

if TYPE_CHECKING:  # rich takes 0.2 s to load, which `ltm --help` does not need
    from rich.status import Status

    from ltm_core.raster.dem import Dem
    from ltm_ros.runtime.health import NodeRow

Cell = str | tuple[str, str]  # a text, or a style of rich and the text
Row = Sequence[Cell]

Overwrite = Annotated[bool, Option("--overwrite", help="Overwrite existing files.")]
_DEM = Option(metavar="FILE", help="Elevation raster; repeat for coarser surrounding ones.")
Dems = Annotated[list[Path], _DEM]
OptionalDems = Annotated[list[Path] | None, _DEM]
Crs = Annotated[str | None, Option(help="CRS of a raster that states none, such as EPSG:32611.")]
Domain = Annotated[int | None, Option(min=0, max=232, help="ROS domain. Default: ROS_DOMAIN_ID, else 0.")]
OnlyCameras = Annotated[list[str] | None, Option(help="Use only this camera. Repeatable.")]


def command_group(help_: str = "") -> typer.Typer:
    """Return a group of commands, whose help is plain text."""
    return typer.Typer(no_args_is_help=True, add_completion=False, rich_markup_mode=None, help=help_)


def numbers(text: str, option: str, counts: tuple[int, ...] = ()) -> list[float]:
    """Return comma-separated numbers. Raises ConfigError if their count is not one that the option accepts."""
    try:
        values = [float(part) for part in text.replace(";", ",").replace(" ", ",").split(",") if part]
    except ValueError as error:
        raise ConfigError(f"{option} must be numbers separated by commas, got {text!r}") from error
    if not all(math.isfinite(value) for value in values) or (counts and len(values) not in counts) or not values:
        wanted = f"{' or '.join(map(str, counts))} " if counts else ""
        raise ConfigError(f"{option} needs {wanted}finite numbers separated by commas, got {text!r}")
    return values


def say(text: str, style: str = "") -> None:
    """Print lines as they are, in a style of rich, wrapped to the terminal."""
    from rich.console import Console
    from rich.text import Text

    Console().print(Text(text, style))


def warn(text: str) -> None:
    """Print a warning."""
    say(text, "yellow")


def working(what: str) -> "Status":
    """Return a context that shows what the command is doing."""
    from rich.console import Console

    return Console().status(what)


def print_table(title: str, columns: Sequence[str], rows: Iterable[Row | None]) -> None:
    """Print a table. Its texts, which may be those of files and cameras, are no markup.

    Args:
        title: above the table; "" for none.
        columns: their names; a name that begins with ">" makes its column right-aligned and never wrapped. If all names
            are empty, the table has no header.
        rows: the cells of each row; None draws a line between two rows."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    made = Table(title=Text(title, "table.title") if title else None, title_justify="left", show_header=any(columns))
    for name in columns:
        number = name.startswith(">")
        made.add_column(name.removeprefix(">"), justify="right" if number else "left", no_wrap=number, overflow="fold")
    for row in rows:
        if row is None:
            made.add_section()
        else:
            made.add_row(*(Text(cell) if isinstance(cell, str) else Text(cell[1], cell[0]) for cell in row))
    Console().print(made)


def open_dems(rasters: Sequence[Path], crs: str | None) -> "Dem":
    """Open the terrain of `--dem`, finest first, and print what may be wrong with it. `crs`: of the first."""
    from ltm_core.raster.dem_stack import open_terrain

    return print_doubts(open_terrain([(rasters[0], crs), *((raster, None) for raster in rasters[1:])]))


def print_doubts(dem: "Dem") -> "Dem":
    """Print to stderr what may be wrong with a terrain; return it."""
    for doubt in dem.doubts:
        typer.secho(doubt.text, fg="yellow", err=True)
    return dem


def print_findings(rows: Iterable[tuple[str, str, str, str, str]]) -> None:
    """Print the results of checks by area: area, state, the state's style, what was checked, what was found."""
    cells: list[Row | None] = []
    last = ""
    for area, state, style, name, found in rows:
        if area != last:
            cells.append(None)
        cells.append((area if area != last else "", (style, state), name, found))
        last = area
    print_table("", ("", "", "what", "found"), cells)


@contextmanager
def progress_bar(what: str, loops: bool = False) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar; yields `update(done, total)`. With `loops`, a full bar starts again."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns) as bar:
        task = bar.add_task(what, total=None)

        def update(done: int, total: int) -> None:
            bar.update(task, completed=(done - 1) % total + 1 if loops else done, total=total)

        yield update


@contextmanager
def stop_on_signals(event: threading.Event) -> Iterator[None]:
    """Set the event on SIGINT and SIGTERM instead of ending the process, within the context."""
    before = {number: signal.signal(number, lambda *_: event.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def print_nodes(rows: "Sequence[NodeRow]") -> None:
    """Print messages in and out, drops by cause with an example of each, and latency since capture."""
    columns = ["node", ">in", ">out", ">drops", ">p50 ms", ">p95 ms", ">work ms"]
    if any(row.causes for row in rows):
        columns.append("dropped because")
    cells: list[Row] = []
    for row in rows:
        times = (row.latency_p50_ms, row.latency_p95_ms, row.work_p50_ms)
        shown = ["" if math.isnan(t) else f"{t:.0f}" for t in times]
        drops: Cell = ("red", str(row.dropped)) if row.dropped else "0"
        causes = [row.causes] if row.causes else []
        cells.append((_short(row.node), str(row.received), str(row.published), drops, *shown, *causes))
    print_table("nodes: frames and latency", columns, cells)
    for row in rows:
        for reason in row.reasons:
            say(f"{_short(row.node)} dropped by {reason}", "red")
    say("in, out: frames; p50, p95: latency since capture; work: median time in the node")


def outcome(summaries: Mapping[str, Mapping[str, str]]) -> list[tuple[str, str]]:
    """Return the results of a replay as rows (what, how much): verdicts on depth, cells seen and changed, events. They
    are in the key -> value texts of the nodes' diagnostics."""
    rows = []
    for name, summary in sorted(summaries.items()):
        counts = {key: int(value) for key, value in summary.items() if key.startswith(("noted.", "cells."))}
        for what, prefix in (("verdicts", "noted.verdict."), ("cells", "cells."), ("events", "noted.")):
            found = {key.removeprefix(prefix): counts.pop(key) for key in list(counts) if key.startswith(prefix)}
            if found:
                rows.append((f"{_short(name)}: {what}", ", ".join(f"{key} {n:,}" for key, n in found.items())))
            if what == "verdicts" and found and "last_verdict" in summary:
                rows.append((f"{_short(name)}: the last that was not ok", summary["last_verdict"]))
    return rows


def _short(node: str) -> str:
    """Return the name of a node without its site."""
    return "/".join(node.split("/")[2:]) or node
