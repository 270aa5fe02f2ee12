"""`ltm-lab bench memory`: the peak memory of each command on a large DEM."""

from pathlib import Path
from typing import Annotated

import typer

from ltm_lab.cli.bench.runs import print_conditions, print_table, write_json
from ltm_lab.options import JsonFile


def memory(
    size: Annotated[int, typer.Option(help="Cells of 1 m per side of the DEM.", min=2000)] = 11_500,
    json_path: JsonFile = None,
) -> None:
    """Run each command on a site with a large DEM, in a process of its own, and measure its peak memory."""
    import tempfile

    from rich.console import Console

    from ltm_lab.bench.measure import conditions
    from ltm_lab.bench.memory import commands, make_site, run_command

    console, state = Console(), conditions(("numpy", "numba", "rasterio", "onnxruntime"))
    print_conditions(console, state)
    used = {}
    with tempfile.TemporaryDirectory(prefix="ltm-memory-") as folder, console.status("writing the site") as status:
        make_site(Path(folder), size)
        for name, arguments in commands(Path(folder)).items():
            status.update(f"ltm {name}")
            used[name] = run_command(arguments)
    print_table(
        console,
        f"DEM of {size:,} x {size:,} cells ({size**2 * 4 / 1e6:,.0f} MB), photos of 1920 x 1080",
        ("command", "peak memory, MB"),
        [(f"ltm {name}", f"{peak:,.0f}") for name, peak in used.items()],
    )
    write_json(json_path, state, size=size, peak_mb=used)
