"""Read lists of names, and print tables of scores."""

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table


def names_in(text: str) -> list[str]:
    """Return the names in a text that separates them by commas, each once."""
    return list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))


def print_table(
    console: Console, title: str, columns: Sequence[str], rows: Iterable[Sequence[object]], note: str = ""
) -> None:
    """Print a table: the first column to the left, all others to the right; an empty row separates sections."""
    table = Table(title=title, title_justify="left")
    for index, column in enumerate(columns):
        table.add_column(column, justify="right" if index else "left")
    for row in rows:
        if row:
            table.add_row(*map(str, row))
        else:
            table.add_section()
    console.print(table)
    if note:
        console.print(note, highlight=False)
