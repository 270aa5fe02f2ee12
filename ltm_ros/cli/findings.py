"""The table of a check: what was looked at, area by area, and how it stands."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table


def findings_table(rows: Iterable[tuple[str, str, str, str, str]]) -> Table:
    """`rows`: area, state, the state's style, what was looked at, and what was found; those of an area together."""
    from rich.markup import escape
    from rich.table import Table

    table = Table("", "", "what", "found")
    last = ""
    for area, state, style, name, found in rows:
        if area != last:
            table.add_section()
        table.add_row(escape(area) if area != last else "", f"[{style}]{state}[/]", escape(name), escape(found))
        last = area
    for column in table.columns:
        column.overflow = "fold"
    return table
