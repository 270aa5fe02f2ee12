"""What the benchmark commands share: numbers in options, the machine's description, tables, and JSON files."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from ltm_lab.bench.measure import Machine


def numbers(text: str) -> list[float]:
    """Return positive numbers from a list with commas. Raises BadParameter."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise typer.BadParameter(f"{text!r} is not a list of numbers; separate numbers with commas") from error
    if min(values) <= 0:
        raise typer.BadParameter(f"{text!r} holds a number that is not positive; give positive numbers")
    return values


def print_conditions(console: "Console", machine: "Machine") -> None:
    """Print processor, load and versions in one line."""
    load = " ".join(f"{v:.2f}" for v in machine.load_average)
    versions = ", ".join(f"{name} {number}" for name, number in machine.versions.items())
    console.print(f"{machine.cpu}, {machine.cores} cores, load average {load}, Python {machine.python}, {versions}")


def print_table(
    console: "Console", title: str, columns: Sequence[str], rows: Sequence[Sequence[object]], caption: str = ""
) -> None:
    """Print a table: the first column names what the others measure."""
    from rich.table import Table

    table = Table(title=title, caption=caption or None)
    for number, column in enumerate(columns):
        table.add_column(column, justify="right" if number else "left", overflow="fold")
    for row in rows:
        table.add_row(*(str(value) for value in row))
    console.print(table)


def write_json(path: Path | None, machine: "Machine", **figures: Any) -> None:
    """Write the figures with the machine's description, if a file was requested."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        content = {"conditions": machine.as_dict()} | figures
        path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
