"""`ltm run`, `ltm region` and `ltm certs`: run a site, or the map of a region.

Each function imports what it needs: `run` must stay small in memory, and the others need extras."""

import os
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from ltm_ros.cli.output import Domain, OnlyCameras


def region(config: Annotated[Path, Argument(help="Region file (YAML).")]) -> None:
    """Run the fuel map of a region: merge its towers' votes (MQTT), write GeoTIFFs. Ctrl-C or SIGTERM ends it."""
    from ltm_ros.runtime.ros_environment import thread_limits

    # Set before NumPy is loaded: more threads slow it down on arrays of a thousand cells.
    os.environ.update(thread_limits(busy=False))

    from ltm_core.uplink.config import load_region
    from ltm_ros.region.service import run_region

    run_region(load_region(config))


def certs(
    folder: Annotated[Path, Argument(help="Folder for the files, created if missing; existing files are kept.")],
    region: Annotated[str, Option(help="Name of the region.")],
    tower: Annotated[list[str] | None, Option(help="Name of a tower. Repeatable.")] = None,
    host: Annotated[list[str] | None, Option(help="Host name or address of the broker. Default: this machine.")] = None,
    listen: Annotated[str, Option(help="Address on which the broker listens.")] = "127.0.0.1",
    port: Annotated[int, Option(min=1, max=65535, help="TCP port of the broker.")] = 8883,
    days: Annotated[int, Option(min=1, max=3650, help="Validity of the certificates in days.")] = 365,
) -> None:
    """Make certificates for a region's broker, map and towers, and a mosquitto configuration.

    Whoever can read ca.key can impersonate any tower: store it elsewhere. Use your own authority for more than a trial.
    """
    from ltm_ros.region.certs import TrialAuthority

    hosts = host or ["localhost", "127.0.0.1", "::1"]
    new = TrialAuthority(folder, days).make(region, tower or (), hosts, listen, port)
    for path in new:
        typer.echo(f"wrote {path}")
    if not new:
        typer.echo(f"{folder}: nothing was missing")


def run(
    site: Annotated[Path, Argument(help="Site file (YAML).")],
    domain: Domain = None,
    record: Annotated[Path | None, Option(help="New folder to record to; the newest files are kept.")] = None,
    view: Annotated[bool, Option("--view", help="Also serve a live view on this machine.")] = False,
    sim_time: Annotated[bool, Option("--sim-time", help="Use /clock, as published by `ltm replay`.")] = False,
    only: OnlyCameras = None,
    state: Annotated[
        Path | None, Option(help="Folder that keeps fuel map, terrain and outbox. Default: the site file's, else none.")
    ] = None,
) -> None:
    """Run a site: start its nodes, restart those that die or hang; Ctrl-C or SIGTERM stops them in order.

    Prints every line of the nodes, and reports to systemd if that started it (NOTIFY_SOCKET).
    Errors that `ltm check` finds end it before any process starts: exit code 78 if the site file must be corrected."""
    from ltm_ros.launching.graph import ParameterValue, Wanted, describe
    from ltm_ros.launching.kernels import compile_ahead
    from ltm_ros.launching.runner import Runner, print_line
    from ltm_ros.launching.service_manager import ServiceManager
    from ltm_ros.launching.site_check import NotReadyError, require_ready
    from ltm_ros.runtime.process_memory import settle, steady_allocation

    steady_allocation()
    manager = ServiceManager.of_environment(os.environ)
    named = {"state": state, "record": record}
    folders = {purpose: folder.expanduser().resolve() for purpose, folder in named.items() if folder is not None}
    places = [str(folder) for folder in folders.values()]
    kept: dict[str, ParameterValue] = {} if state is None else {"folder": str(folders["state"])}
    wanted = Wanted(
        cameras=only or (),
        view={"serve": True} if view else None,
        record=None if record is None else {"bag": str(folders["record"])},
        health={"folders": places} if places else {},
        parameters=dict.fromkeys(("fuel_map", "terrain", "pose", "uplink"), kept) if kept else {},
    )
    try:
        config = require_ready(site, wanted, lambda doubt: typer.echo(f"-- {doubt}"), folders)
    except NotReadyError as error:
        typer.echo("\n".join(f"ltm: {line}" for line in str(error).splitlines()), err=True)
        manager.report(str(error), ready=False, alive=False)
        raise typer.Exit(error.status) from error
    if state is not None:
        folders["state"].mkdir(parents=True, exist_ok=True)
    graph = describe(config, site, sim_time=sim_time, **wanted)
    typer.echo(f"-- {config.name}: {len(graph)} nodes in {len(graph.processes)} processes; Ctrl-C stops them")
    if view:
        from ltm_ros.viewer.server import GRPC_PORT, WEB_PORT, web_url

        given = graph.node("viewer").parameters  # its ports may be in the site file
        web, grpc = (int(str(given.get(*port))) for port in (("web_port", WEB_PORT), ("grpc_port", GRPC_PORT)))
        typer.echo(f"-- live view (available once the nodes run): {web_url(web, grpc)}")
    if config.health is not None:
        scheme = "https" if config.health.certificate else "http"
        typer.echo(f"-- health and status page: {scheme}://{config.health.address}:{config.health.port}")
    compile_ahead(graph, site, typer.echo, lambda: manager.report("compiling kernels", False, True))
    settle()
    status = Runner(graph, domain_id=domain).run(manager)
    # Written without echo: a closed console is not an error of the run.
    print_line(f"-- {config.name} has ended")
    raise typer.Exit(status)
