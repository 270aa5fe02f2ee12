"""`ltm record`: records topics of a running graph into a bag."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def record(
    site: Annotated[Path, typer.Option("--site", help="Site file.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Bag folder to write.")],
    topics: Annotated[
        list[str] | None,
        typer.Argument(help="Topics or patterns such as '/site/*/depth/*'; default: the site's inputs and results."),
    ] = None,
    sim_time: Annotated[bool, typer.Option("--sim-time", help="Stamp by /clock, as beside a replay.")] = False,
    domain: Annotated[int | None, typer.Option(help="ROS domain of the graph; default: the environment's.")] = None,
) -> None:
    """Record a site's topics to OUT until Ctrl-C."""
    from dataclasses import replace

    from ltm_core.output_io import require_folder
    from ltm_core.site_io import load_site
    from ltm_ros.launching.graph import Graph, ParameterValue, describe
    from ltm_ros.launching.runner import Runner, new_log_folder

    parameters: dict[str, ParameterValue] = {"bag": str(out.resolve())}
    if topics:
        parameters["topics"] = list(topics)
    require_folder(out, "a bag")  # of former ones the recorder keeps clear
    config = load_site(site)
    whole = describe(config, site, sim_time=sim_time, record=parameters)
    # Beside a graph the recorder is an extra; here it is all there is to run.
    graph = Graph(config.name, (replace(whole.node("recorder"), required=True),))
    runner = Runner(graph, domain_id=domain, log_folder=new_log_folder(config.name))
    raise typer.Exit(runner.run())
