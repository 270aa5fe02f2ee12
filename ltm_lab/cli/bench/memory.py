"""`ltm-lab bench memory`: the most memory that each command takes on a large DEM."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_lab.cli.bench.runs import print_conditions, write_runs
from ltm_ros.cli.output import JsonFile


def memory(
    size: Annotated[int, typer.Option(help="Cells of 1 m on a side of the DEM.", min=1000)] = 11_500,
    folder: Annotated[
        Path | None, typer.Option(help="Empty folder for the site; left there. Default: one that is removed.")
    ] = None,
    json_path: JsonFile = None,
) -> None:
    """Run each command on a site with a large DEM, in a process of its own, and tell the most memory that it held."""
    import tempfile
    from dataclasses import asdict

    from rich.console import Console

    from ltm_core.base.errors import ConfigError
    from ltm_lab.bench.measure import conditions
    from ltm_lab.bench.memory import make_site, measure

    console = Console()
    if folder is not None and folder.exists() and any(folder.iterdir()):
        raise ConfigError(f"{folder} is not empty; name a new folder")
    state = conditions(("numpy", "numba", "rasterio", "onnxruntime"))
    print_conditions(console, state)
    console.print(
        f"DEM of {size:,} x {size:,} cells, {size**2 * 4 / 1e6:,.0f} MB; photos of 1920 x 1080; most memory held:"
    )
    used = []
    with tempfile.TemporaryDirectory(prefix="ltm-memory-") as own:
        place = folder or Path(own)
        place.mkdir(parents=True, exist_ok=True)
        with console.status("making the site") as status:
            make_site(place, size)
            for use in measure(place, lambda name: status.update(f"ltm {name}")):
                used.append(use)
                console.print(f"{use.peak_mb:8,.0f} MB  ltm {use.name}", highlight=False)
    if json_path is not None:
        write_runs(json_path, state, [{"size": size} | asdict(use) for use in used])
