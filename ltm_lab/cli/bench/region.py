"""`ltm-lab bench region`: whether and how fast a region's map catches up after an outage, with and without kills."""

from __future__ import annotations

from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile


def region(
    towers: Annotated[int, typer.Option(help="Towers, of one camera each.", min=1, max=50)] = 10,
    seconds: Annotated[int, typer.Option(help="Of votes while the link is down, a frame a second.", min=10)] = 3600,
    kills: Annotated[int, typer.Option(help="Of towers, the map and the broker, with SIGKILL.", min=0)] = 50,
    seed: Annotated[int, typer.Option(help="Of what is killed when.")] = 0,
    extent: Annotated[float, typer.Option(help="Side of the region, metres.", min=3000)] = 12_000.0,
    views: Annotated[int, typer.Option(help="Directions of each camera.", min=1)] = 4,
    calm: Annotated[bool, typer.Option(help="A run without kills before that with kills.")] = True,
    json_path: JsonFile = None,
) -> None:
    """Fill the outboxes of towers whose link is down, let it return, and compare the map with that of all frames.

    Needs mosquitto. Votes are of a terrain that is made up, with labels that are made up.
    """
    from dataclasses import asdict

    from rich.console import Console
    from rich.table import Table

    from ltm_lab.bench.measure import conditions
    from ltm_lab.bench.region import run_bench
    from ltm_lab.cli.bench.runs import print_conditions
    from ltm_lab.evaluation.figures_io import write_figures

    if not (calm or kills):
        raise typer.BadParameter("--no-calm with --kills 0 leaves nothing to run", param_hint="--no-calm")
    console = Console()
    state = conditions(("numpy", "numba", "paho-mqtt", "cryptography"))
    print_conditions(console, state)
    results = run_bench(towers, seconds, kills, seed, extent, views, lambda line: console.print(f"-- {line}"), calm)
    table = Table(title=f"{towers} towers, {seconds} s of votes while the link was down")
    for column in (
        "run",
        "kills",
        "frames",
        "in the map",
        "the same to the bit",
        "caught up in s",
        "times real time",
        "on cores of their own",
        "CPU ms a frame: towers, broker, map",
    ):
        table.add_column(column, justify="left" if column == "run" else "right")
    for name, result in results.items():
        table.add_row(
            name,
            str(sum(result.kills.values())),
            str(result.frames),
            str(result.stored),
            "yes" if result.equal else "NO",
            f"{result.catch_up_s:.1f}",
            f"{result.times_real:.1f}",
            "" if result.times_real_on_cores is None else f"{result.times_real_on_cores:.1f}",
            ", ".join(f"{ms:.2f}" for ms in result.cpu_ms_a_frame.values()),
        )
    console.print(table)
    console.print(
        f"{next(iter(results.values())).bytes_a_frame:,.0f} bytes a frame; "
        + "; ".join(f"{name}: kills {one.kills}, given up {one.dropped}" for name, one in results.items())
    )
    if json_path is not None:
        runs = {name: asdict(result) for name, result in results.items()}
        write_figures(json_path, {"conditions": state.as_dict(), "towers": towers, "seconds": seconds, **runs})
    raise typer.Exit(0 if all(result.equal for result in results.values()) else 1)
