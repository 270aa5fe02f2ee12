"""`ltm doctor`: check the installation, and print the command that installs what is missing."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

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


def doctor(
    json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
    site: Annotated[
        Path | None, typer.Option(help="Site file of a tower, for its port; default: /etc/ltm/site.yaml, if there.")
    ] = None,
) -> None:
    """Look at the installation. Exit code 1 when something required is missing."""
    from rich.console import Console

    from ltm_ros.tower.doctor import as_json, examine, healthy, summed_up
    from ltm_ros.tower.doctor_finding import Condition

    findings = examine(site)
    if json:
        typer.echo(as_json(findings))
        raise typer.Exit(0 if healthy(findings) else 1)
    styles = {
        Condition.OK: "green",
        Condition.OPTIONAL: "dim",
        Condition.WARNING: "yellow",
        Condition.MISSING: "bold red",
    }
    rows = [(one.area, str(one.state), styles[one.state], one.name, one.detail) for one in summed_up(findings)]
    Console().print(findings_table(rows))
    # Below the table, unbroken, so that they can be copied.
    for finding in findings:
        if finding.remedy:
            typer.echo(f"{finding.state} {finding.name}: {finding.remedy}")
    missing = [finding.name for finding in findings if finding.state is Condition.MISSING]
    typer.echo(f"missing: {', '.join(missing)}" if missing else "nothing required is missing")
    raise typer.Exit(1 if missing else 0)
