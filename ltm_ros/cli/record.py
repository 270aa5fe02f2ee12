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
    max_gb: Annotated[
        float | None,
        typer.Option(
            min=0,
            help="Of all recordings of this name; the oldest files go. 0: no bound. Default: the site file's, else "
            "16 GB, or half of the disk where that is less.",
        ),
    ] = None,
    min_free_gb: Annotated[
        float | None,
        typer.Option(
            min=0,
            help="Free space under which recording stops. Default: the site file's, else 2 GB, or a tenth of the disk "
            "where that is less.",
        ),
    ] = None,
    sim_time: Annotated[bool, typer.Option("--sim-time", help="Stamp by /clock, as beside a replay.")] = False,
    domain: Annotated[int | None, typer.Option(help="ROS domain of the graph; default: the environment's.")] = None,
) -> None:
    """Record a site's topics to OUT until Ctrl-C; of a long recording the newest files stay (--max-gb)."""
    from dataclasses import replace

    from ltm_core.site.site_io import load_site
    from ltm_core.storage.disk_io import require_folder
    from ltm_ros.launching.graph import Graph, ParameterValue, describe
    from ltm_ros.launching.node_log import new_log_folder
    from ltm_ros.launching.runner import Runner

    parameters: dict[str, ParameterValue] = {"bag": str(out.resolve())}
    for name, gigabytes in (("max_bytes", max_gb), ("min_free_bytes", min_free_gb)):
        if gigabytes is not None:
            parameters[name] = round(gigabytes * 1e9)
    if topics:
        parameters["topics"] = list(topics)
    require_folder(out, "a bag")  # of former ones the recorder keeps clear
    config = load_site(site)
    whole = describe(config, site, sim_time=sim_time, record=parameters)
    # Beside a graph the recorder is an extra; here it is all there is to run.
    graph = Graph(config.name, (replace(whole.node("recorder"), required=True),))
    runner = Runner(graph, domain_id=domain, log_folder=new_log_folder(config.name))
    raise typer.Exit(runner.run())
