"""`ltm doctor`: checks the installation; for each thing that is missing, names the command that installs it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.tables import print_findings


def doctor(
    json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
    site: Annotated[
        Path | None, typer.Option(help="Site file of a tower, for its port; default: /etc/ltm/site.yaml, if there.")
    ] = None,
) -> None:
    """Look at the installation. Exit code 1 when something required is missing."""
    from rich.console import Console

    from ltm_ros.tower.doctor import as_json, examine, healthy, summed_up
    from ltm_ros.tower.doctor_finding import DoctorState

    findings = examine(site)
    if json:
        typer.echo(as_json(findings))
        raise typer.Exit(0 if healthy(findings) else 1)
    styles = {
        DoctorState.OK: "green",
        DoctorState.OPTIONAL: "dim",
        DoctorState.WARNING: "yellow",
        DoctorState.MISSING: "bold red",
    }
    rows = [(one.area, str(one.state), styles[one.state], one.name, one.detail) for one in summed_up(findings)]
    print_findings(Console(), rows)
    # Below the table, unbroken, so that they can be copied.
    for finding in findings:
        if finding.remedy:
            typer.echo(f"{finding.state} {finding.name}: {finding.remedy}")
    missing = [finding.name for finding in findings if finding.state is DoctorState.MISSING]
    typer.echo(f"missing: {', '.join(missing)}" if missing else "nothing required is missing")
    raise typer.Exit(1 if missing else 0)
