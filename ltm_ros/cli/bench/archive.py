"""`ltm bench archive`: one map whatever works a recording again, and what a frame costs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile


def archive(
    bag: Annotated[Path | None, typer.Argument(help="Bag; default: the demo's.")] = None,
    site: Annotated[Path | None, typer.Option("--site", help="Its site file.")] = None,
    kills: Annotated[int, typer.Option(help="Runs in which a worker is killed at a random moment.", min=0)] = 3,
    seed: Annotated[int, typer.Option(help="Of these moments.")] = 1,
    json_path: JsonFile = None,
) -> None:
    """Work a recording again in several ways, and replay it: the digests of their maps, and the time they took.

    Ends with status 1 where the digests differ.
    """
    import tempfile
    from dataclasses import asdict

    from rich.console import Console
    from rich.table import Table

    from ltm_core.bench.measure import conditions
    from ltm_core.errors import ArchiveError
    from ltm_core.resources import project_path
    from ltm_ros.bench.archive import measure
    from ltm_ros.cli.bench.runs import print_conditions
    from ltm_ros.evaluation.figures_io import write_figures

    if (bag is None) != (site is None):
        raise ArchiveError("give both the bag and its --site, or neither for the demo's")
    console = Console()
    state = conditions(("numpy", "numba", "onnxruntime", "dask", "pyarrow"))
    demo = project_path("bags/demo")
    with tempfile.TemporaryDirectory(prefix="ltm-bench-archive-") as folder, console.status("") as status:
        found = measure(bag or demo / "recording", site or demo / "site.yaml", Path(folder), kills, seed, status.update)
    table = Table(title=f"{found.frames} frames", caption="processor: of this process alone, not of workers")
    for column in ("way", "worked", "killed", "wall s", "processor s", "a frame", "digest"):
        table.add_column(column, justify="left" if column in ("way", "digest") else "right")
    for way in found.ways:
        each = f"{way.cpu_s / way.worked:.3f}" if way.worked and "worker" not in way.name else ""
        spent = f"{way.wall_s:.2f}", f"{way.cpu_s:.2f}"
        table.add_row(way.name, str(way.worked), str(way.kills), *spent, each, way.digest[:12])
    console.print(table)
    console.print(
        f"{len(found.digests)} digest{'s' * (len(found.digests) > 1)} of {len(found.ways)} maps; votes "
        f"{found.votes_bytes / 1e3:.1f} kB a frame in files of a camera's day; {found.peak_mb:.0f} MB at most serially"
    )
    print_conditions(console, state)
    if json_path is not None:
        write_figures(json_path, {"conditions": state.as_dict(), **asdict(found)})
    raise typer.Exit(0 if len(found.digests) == 1 else 1)
