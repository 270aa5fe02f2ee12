"""`ltm demo`: run the whole system on the recording that is shipped with it."""

import os
import shutil
import sys
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from ltm_core.base.errors import ConfigError
from ltm_core.base.resources import project_path
from ltm_core.storage.disk_io import require_folder
from ltm_ros.cli.output import print_nodes, print_table, progress_bar, say

MARK = ".ltm-demo"
"""File in the folder of a demo, which the next one may delete."""


def demo(
    out: Annotated[Path, Option("--out", "-o", help="Output folder.")] = Path("out/demo"),
    domain: Annotated[int, Option(min=0, max=232, help="ROS domain of the demo's graph.")] = 87,
) -> None:
    """Run the live graph on a small recording; write a report, a fuel map and a Rerun recording to OUT."""
    from ltm_ros.demo.report import score_rows  # here, because help needs none of them
    from ltm_ros.demo.simulated import run_demo

    clear_demo(out)
    with progress_bar("demo", loops=True) as progress:
        nodes, score = run_demo(project_path("bags"), out, domain, progress, say)
    print_nodes(nodes)
    print_table("against truth", ("", ""), score_rows(score))
    say(f"report: {out / 'report.html'}")
    shown = to_type(f"ltm view --rrd {out / 'demo.rrd'}")
    typer.echo(f"in Rerun: {shown}")  # on one line, to be copied
    drops = sum(row.dropped for row in nodes)
    if drops:
        say(f"{drops} messages were dropped; the table says where and why", "red")
        raise typer.Exit(1)


def clear_demo(out: Path) -> None:
    """Make the folder of a demo; remove the results of an earlier one. Raises ConfigError if it has other files."""
    require_folder(out)
    if out.exists() and any(out.iterdir()):
        if not (out / MARK).exists():
            raise ConfigError(f"{out} is not the folder of an earlier demo; give another with --out, or delete it")
        shutil.rmtree(out)
    out.mkdir(parents=True, exist_ok=True)
    (out / MARK).touch()


def to_type(command: str) -> str:
    """Return a command for the user's shell; without `ltm` on its PATH, the environment is activated first."""
    if shutil.which("ltm"):
        return command
    return f"source {os.path.relpath(Path(sys.prefix) / 'bin/activate')} && {command}"
