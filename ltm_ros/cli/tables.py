"""The tables that commands print."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str] | None]) -> Table:
    """Return a table for a terminal. Cells may hold markup; escape text that others wrote.

    Args:
        title: above the table; "" for none.
        columns: their names; a name that begins with ">" makes its column right-aligned and never wrapped. If all names
            are empty, the table has no header.
        rows: the cells of each row; None draws a line between two rows.
    """
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
