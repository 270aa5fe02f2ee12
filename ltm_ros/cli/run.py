"""`ltm run`: runs a site's graph until Ctrl-C or SIGTERM."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def run(
    site: Annotated[Path, typer.Argument(help="Site file (YAML).")],
    domain: Annotated[
        int | None, typer.Option(min=0, max=232, help="ROS domain. Default: ROS_DOMAIN_ID, else 0.")
    ] = None,
    record: Annotated[Path | None, typer.Option(help="Also record the graph's topics into this new folder.")] = None,
    view: Annotated[bool, typer.Option("--view", help="Also serve a live view on this machine.")] = False,
    sim_time: Annotated[bool, typer.Option("--sim-time", help="Follow /clock, as `ltm replay` publishes it.")] = False,
    only: Annotated[list[str] | None, typer.Option(help="Only this camera; may be given several times.")] = None,
    state: Annotated[
        Path | None,
        typer.Option(
            help="Folder, made if missing, where the fuel map and the terrain outlive stops, kills and power cuts. "
            "Default: what the site file's nodes say, else nothing is kept."
        ),
    ] = None,
    logs: Annotated[
        Path | None, typer.Option(help="Folder for the nodes' output. Default: a new one in ~/.local/state/ltm.")
    ] = None,
) -> None:
    """Run a site: each node a process, restarted when it dies; Ctrl-C or SIGTERM stops all of them in order."""
    from ltm_core.output_io import require_folder
    from ltm_core.site_io import load_site
    from ltm_msgs_py.bag.writer import BagWriter
    from ltm_ros.launching.graph import ParameterValue, describe
    from ltm_ros.launching.runner import Runner, new_log_folder

    for folder, what in ((state, "the map"), (logs, "logs")):
        if folder is not None:
            require_folder(folder.expanduser(), what)
    if record is not None:
        BagWriter.require_free(record.expanduser())
    config = load_site(site)
    kept: dict[str, ParameterValue] = {}
    if state is not None:
        kept["folder"] = str(state.expanduser().resolve())
        state.expanduser().mkdir(parents=True, exist_ok=True)
    graph = describe(
        config,
        site,
        cameras=only or (),
        sim_time=sim_time,
        view={"serve": True} if view else None,
        record={"bag": str(record.expanduser().resolve())} if record is not None else None,
        parameters={"fuel_map": kept, "terrain": kept},
    )
    runner = Runner(graph, log_folder=logs or new_log_folder(config.name), domain_id=domain)
    typer.echo(f"-- {config.name}: {len(graph)} nodes, logs in {runner.log_folder}; Ctrl-C stops them")
    raise typer.Exit(runner.run())
