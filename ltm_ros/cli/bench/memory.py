"""`ltm bench memory`: the most memory that each command takes on a large DEM."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile


def memory(
    size: Annotated[int, typer.Option(help="Cells of 1 m on a side of the DEM.", min=1000)] = 11_500,
    folder: Annotated[
        Path | None, typer.Option(help="Empty folder for the site; left there. Default: one that is removed.")
    ] = None,
    json_path: JsonFile = None,
) -> None:
    """Run each command on a site with a large DEM, in a process of its own, and tell the most memory that it held."""
    import json
    import tempfile
    from dataclasses import asdict

    from rich.console import Console
    from rich.table import Table

    from ltm_core.bench.measure import conditions
    from ltm_core.errors import ConfigError
    from ltm_ros.bench.memory import make_site, measure

    console = Console()
    if folder is not None and folder.exists() and any(folder.iterdir()):
        raise ConfigError(f"{folder} is not empty; name a new folder")
    state = conditions(("numpy", "numba", "rasterio", "onnxruntime"))
    with tempfile.TemporaryDirectory(prefix="ltm-memory-") as own:
        place = folder or Path(own)
        place.mkdir(parents=True, exist_ok=True)
        with console.status("making the site"):
            make_site(place, size)
        with console.status("running") as status:
            used = list(measure(place, lambda name: status.update(name)))
    table = Table(
        title=f"most memory held; DEM of {size:,} x {size:,} cells, {size**2 * 4 / 1e6:,.0f} MB; photos of 1920 x 1080",
        caption=f"{state.cpu}, Python {state.python}, "
        + ", ".join(f"{name} {number}" for name, number in state.versions.items()),
    )
    table.add_column("command")
    table.add_column("MB", justify="right")
    for use in used:
        table.add_row(f"ltm {use.name}", f"{use.peak_mb:,.0f}")
    console.print(table)
    if json_path is not None:
        content = {"size": size, "conditions": state.as_dict(), "commands": [asdict(use) for use in used]}
        json_path.write_text(json.dumps(content, indent=1))
