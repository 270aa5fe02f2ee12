"""`ltm check`, `ltm run`, `ltm region` and `ltm certs`: check and run a site, or the map of a region."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_core.base.errors import LtmError, SiteFinding, SiteVerdict
from ltm_core.storage.disk_io import require_files
from ltm_ros.cli.output import Overwrite, print_findings

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.console import Console

    from ltm_core.base.errors import SiteFinding
    from ltm_core.base.types import RgbImage
    from ltm_core.site.site_check import SiteCheck
    from ltm_ros.launching.graph import ParameterValue


def region(config: Annotated[Path, typer.Argument(help="Region file (YAML).")]) -> None:
    """Run the fuel map of a region: merge its towers' votes (MQTT), write GeoTIFFs. Ctrl-C or SIGTERM ends it."""
    from ltm_ros.runtime.ros_environment import thread_limits

    # Set before NumPy is loaded: more threads slow it down on arrays of a thousand cells.
    os.environ.update(thread_limits(busy=False))

    from ltm_core.uplink.config import load_region
    from ltm_ros.region.service import run_region

    run_region(load_region(config))


def certs(
    folder: Annotated[Path, typer.Argument(help="Folder for the files, created if missing; existing files are kept.")],
    region: Annotated[str, typer.Option(help="Name of the region.")],
    tower: Annotated[list[str] | None, typer.Option(help="Name of a tower. Repeatable.")] = None,
    host: Annotated[
        list[str] | None, typer.Option(help="Host name or address of the broker. Default: this machine.")
    ] = None,
    listen: Annotated[str, typer.Option(help="Address on which the broker listens.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="TCP port of the broker.")] = 8883,
    days: Annotated[int, typer.Option(min=1, max=3650, help="Validity of the certificates in days.")] = 365,
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
    site: Annotated[Path, typer.Argument(help="Site file (YAML).")],
    domain: Annotated[
        int | None, typer.Option(min=0, max=232, help="ROS domain. Default: ROS_DOMAIN_ID, else 0.")
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(help="Also record the graph's topics to this new folder; long recordings keep the newest files."),
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Also serve a live view on this machine.")] = False,
    sim_time: Annotated[bool, typer.Option("--sim-time", help="Use /clock, as published by `ltm replay`.")] = False,
    only: Annotated[list[str] | None, typer.Option(help="Use only this camera. Repeatable.")] = None,
    state: Annotated[
        Path | None,
        typer.Option(
            help="Folder, created if missing, that keeps fuel map, terrain and outbox across restarts. Default: "
            "the site file's, else nothing is kept."
        ),
    ] = None,
) -> None:
    """Run a site: start its nodes, restart those that die or hang; Ctrl-C or SIGTERM stops them in order.

    Prints every line of the nodes, and reports to systemd if that started it (NOTIFY_SOCKET).
    Errors that `ltm check` finds end it before any process starts: exit code 78 if the site file must be corrected."""
    from ltm_ros.launching.graph import describe
    from ltm_ros.launching.kernels import compile_ahead
    from ltm_ros.launching.runner import Runner, print_line
    from ltm_ros.launching.service_manager import ServiceManager
    from ltm_ros.launching.site_check import NotReadyError, Wanted, require_ready
    from ltm_ros.runtime.process_memory import settle, steady_allocation

    steady_allocation()
    manager = ServiceManager.of_environment(os.environ)
    folders: dict[str, Path] = {}
    kept: dict[str, ParameterValue] = {}
    recorded: dict[str, ParameterValue] | None = None
    if state is not None:
        folders["state"] = state.expanduser().resolve()
        kept["folder"] = str(folders["state"])
    if record is not None:
        folders["record"] = record.expanduser().resolve()
        recorded = {"bag": str(folders["record"])}
    parameters = dict.fromkeys(("fuel_map", "terrain", "pose", "uplink"), kept) if kept else {}
    seen: dict[str, ParameterValue] | None = {"serve": True} if view else None
    try:
        wanted = Wanted(only or (), seen, recorded, {}, parameters, folders)
        config = require_ready(site, wanted, lambda doubt: typer.echo(f"-- {doubt}"))
    except NotReadyError as error:
        typer.echo("\n".join(f"ltm: {line}" for line in str(error).splitlines()), err=True)
        manager.report(str(error), ready=False, alive=False)
        raise typer.Exit(error.status) from error
    if state is not None:
        folders["state"].mkdir(parents=True, exist_ok=True)
    graph = describe(
        config,
        site,
        cameras=only or (),
        sim_time=sim_time,
        view=seen,
        record=recorded,
        health={"folders": [str(folder) for folder in folders.values()]} if folders else {},
        parameters=parameters,
    )
    typer.echo(f"-- {config.name}: {len(graph)} nodes in {len(graph.processes)} processes; Ctrl-C stops them")
    if view:
        typer.echo(f"-- live view (available once the nodes run): {_address(graph.node('viewer').parameters)}")
    if config.health is not None:
        scheme = "https" if config.health.certificate else "http"
        typer.echo(f"-- health and status page: {scheme}://{config.health.address}:{config.health.port}")
    compile_ahead(graph, site, typer.echo, lambda: manager.report("compiling kernels", False, True))
    settle()
    status = Runner(graph, domain_id=domain).run(manager)
    # Written without echo: a closed console is not an error of the run.
    print_line(f"-- {config.name} has ended")
    raise typer.Exit(status)


def _address(viewer: Mapping[str, ParameterValue]) -> str:
    """Return the address of the viewer node's page; its ports may be in the site file."""
    from ltm_ros.viewer.server import GRPC_PORT, WEB_PORT, web_url

    web, grpc = (int(str(viewer.get(*port))) for port in (("web_port", WEB_PORT), ("grpc_port", GRPC_PORT)))
    return web_url(web, grpc)


_CELLS = 100_000
"""Number of DEM cells at which the cameras' views are evaluated; takes 1 to 2 s per camera."""


def check(
    site: Annotated[Path, typer.Argument(help="Site file (YAML).")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="PNG to draw: terrain, views, covered ground, prior fuel map.")
    ] = None,
    bag: Annotated[
        Path | None, typer.Option(help="Recording with the views of cameras whose poses are topics.")
    ] = None,
    only: Annotated[list[str] | None, typer.Option(help="Check only this camera. Repeatable.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Check a site: CRS, terrain, cameras, prior, networks, parameters, folders. Exit code 1 if it has errors."""
    from rich.console import Console

    if out is not None:
        require_files([out], overwrite)
    raise typer.Exit(1 if report(Console(), site, out, bag, only or ()) else 0)


def report(
    console: Console, site: Path, out: Path | None = None, bag: Path | None = None, only: Sequence[str] = ()
) -> int:
    """Print the findings about a site, draw it to `out`, and return the number of errors."""
    from ltm_ros.launching.site_check import Wanted, examine

    with console.status("looking"):
        found = examine(site, Wanted(only))
        if bag is not None and found.site is not None and found.dem is not None:
            _add_recorded(found, bag)
    _print(console, found.findings)
    if out is not None and found.dem is not None:
        from ltm_core.pictures import to_png

        with console.status("drawing"):
            out.parent.mkdir(parents=True, exist_ok=True)
            out.write_bytes(to_png(_picture(found)))
        console.print(f"  {out}", highlight=False)
    wrong = len(found.wrong)
    doubtful = sum(finding.verdict is SiteVerdict.DOUBTFUL for finding in found.findings)
    typer.echo(f"{wrong} errors, {doubtful} warnings" if wrong or doubtful else "no errors")
    return wrong


def _print(console: Console, findings: list[SiteFinding]) -> None:
    styles = {SiteVerdict.OK: "green", SiteVerdict.DOUBTFUL: "yellow", SiteVerdict.WRONG: "bold red"}
    order = list(dict.fromkeys(finding.area for finding in findings))
    sorted_by_area = sorted(findings, key=lambda one: order.index(one.area))
    rows = [(one.area, str(one.verdict), styles[one.verdict], one.name, one.said) for one in sorted_by_area]
    print_findings(console, rows)


def _add_recorded(found: SiteCheck, bag: Path) -> None:
    """Add the recorded views of cameras that have no pose in the site file."""
    from ltm_core.site.camera_check import check_views
    from ltm_ros.recordings.recorded_run import recorded_views
    from ltm_ros.recordings.replay.offline import Selection

    assert found.site is not None  # nosec B101 # tells the type checker what holds
    assert found.dem is not None  # nosec B101 # tells the type checker what holds
    try:
        Selection.open(bag, found.site)
        views = recorded_views(bag, found.site)
    except LtmError as error:
        found.findings.append(SiteFinding.of("recording", bag.name, error))
        return
    there = {view.name for view in found.views}
    added = [view for view in views if view.name not in there]
    found.findings += check_views(added, found.dem)
    found.views += added


def _picture(found: SiteCheck) -> RgbImage:
    from dataclasses import replace

    from ltm_core.pictures.trace import map_camera, site_picture
    from ltm_core.visibility.point_visibility import PointVisibility
    from ltm_core.visibility.viewshed import viewshed

    site, dem = found.site, found.dem
    assert site is not None  # nosec B101 # tells the type checker what holds
    assert dem is not None  # nosec B101 # tells the type checker what holds
    geometry, farthest = dem.geometry, site.fuel.max_range
    above = [view for view in found.views if not view.pose.position[2] <= dem.elevation_at(*view.pose.position[:2])]
    seen = None
    if above:
        finest = math.sqrt(geometry.width * geometry.height / _CELLS) * geometry.resolution
        try:
            surface = site.open_surface(dem)
        except LtmError:  # a finding
            surface = dem
        sight = PointVisibility(surface, site.curvature, site.refraction, site.possible_ground)
        whole, near = (
            viewshed(sight, above, max(geometry.resolution, finest), max_range=reach, ground=dem)
            for reach in (math.inf, farthest)
        )
        seen = whole, near
    names = [view.name for view in found.views]
    named = {names.index(name) + (names.count(name) - 1) // 2 for name in names}  # of several views, the middle one
    cameras = [
        camera if k in named else replace(camera, name="") for k, camera in enumerate(map(map_camera, found.views))
    ]
    prior = found.prior
    shown = prior and replace(prior, geometry=site.in_map(prior.geometry))
    return site_picture(dem, cameras, seen, shown, site.origin, _heading(found))


def _heading(found: SiteCheck) -> str:
    assert found.site is not None  # nosec B101 # tells the type checker what holds
    site, shown = found.site, {view.name for view in found.views}
    absent = [name for name in site.cameras if name not in shown]
    said = [f"Site {site.name}, {site.crs}."]
    if shown:
        said.append(
            f"Pixels vote up to {site.fuel.max_range / 1000:g} km. Sectors are horizontal fields of view; their length "
            "has no meaning."
        )
    if absent:
        said.append(f"Pose from a topic: {', '.join(absent)}.")
    return " ".join(said)
