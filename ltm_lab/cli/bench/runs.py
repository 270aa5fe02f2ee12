"""What commands have in common that measure several runs: numbers in options, conditions, a column a run, and JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import typer

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from ltm_lab.bench.measure import Machine

Run = TypeVar("Run")


def numbers(text: str) -> list[float]:
    """Positive numbers with commas. Raises BadParameter."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise typer.BadParameter(f"give numbers with commas, got {text!r}") from error
    if min(values) <= 0:
        raise typer.BadParameter(f"give positive numbers, got {text!r}")
    return values


def print_conditions(console: Console, machine: Machine) -> None:
    """One line: processor, load and versions."""
    load = " ".join(f"{v:.2f}" for v in machine.load_average)
    console.print(f"{machine.cpu}, {machine.cores} cores, load average {load}, Python {machine.python}, ", end="")
    console.print(", ".join(f"{name} {number}" for name, number in machine.versions.items()))


def runs_table(title: str, caption: str, rows: Mapping[str, Callable[[Run], object]], runs: Sequence[Run]) -> Table:
    """A row a figure, by name, a column a run."""
    from rich.table import Table

    table = Table(title=title, caption=caption, show_header=False)
    table.add_column("")
    for _ in runs:
        table.add_column(justify="right")
    for name, value in rows.items():
        table.add_row(name, *(str(value(run)) for run in runs))
    return table


def write_runs(path: Path, machine: Machine, runs: Sequence[Mapping[str, Any]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"conditions": machine.as_dict(), "runs": runs}, indent=2))
