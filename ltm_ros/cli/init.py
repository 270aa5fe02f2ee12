"""`ltm init`: make a site from a point on the map, or add to one."""

import os
import re
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from pyproj import Geod
from typer import Option

from ltm_core.base.errors import ConfigError
from ltm_ros.cli.output import numbers, print_table, progress_bar, say, warn, working
from ltm_ros.site_setup.camera_list import CameraValues, parse_camera, read_cameras
from ltm_ros.site_setup.request import Kind
from ltm_ros.site_setup.site_plan import SitePlan, Wish, carry_out, plan_site
from ltm_ros.site_setup.sources import load_sources

_ASK_FROM = 500_000_000
"""Number of bytes to fetch from which the command waits for a confirmation."""


def init(
    out: Annotated[Path | None, Option("--out", "-o", help="Folder of the site.")] = None,
    lonlat: Annotated[str | None, Option(help="Middle of the site as LON,LAT (WGS 84 degrees).")] = None,
    name: Annotated[str, Option(help="Name of the site: a-z, 0-9 and _.")] = "",
    radius: Annotated[str, Option(help="Half width of the fine DEM, such as 8km or 500m.")] = "8km",
    camera: Annotated[
        list[str] | None, Option(help="NAME=LON,LAT,height=20,azimuth=214,hfov=54; azimuth: true north.")
    ] = None,
    cameras: Annotated[
        Path | None, Option(metavar="FILE", help="Cameras as CSV or GeoJSON, or ALERTCalifornia's list (JSON).")
    ] = None,
    crs: Annotated[str | None, Option(help="Projected CRS. Default: that of --dem, or the UTM zone.")] = None,
    dem: Annotated[list[Path] | None, Option(help="Own DEM: file or folder of tiles, any CRS. Repeatable.")] = None,
    fuel: Annotated[Path | None, Option(help="Own fuel map: landscape, raster of codes, or folder.")] = None,
    surface: Annotated[Path | None, Option(help="Own raster of tree tops and roofs, or of canopy height.")] = None,
    sources: Annotated[str | None, Option(help="File with other data sources (YAML), or `list` to print them.")] = None,
    update: Annotated[Kind | None, Option(help="Raster to replace.")] = None,
    dry_run: Annotated[bool, Option("--dry-run", help="Print what would be fetched, and stop.")] = False,
    yes: Annotated[bool, Option("--yes", "-y", help="Fetch more than 500 MB without asking.")] = False,
) -> None:
    """Make a site: fetch terrain and fuel, write rasters, site.yaml and a check picture. Or add to an existing one."""
    known = load_sources(Path(sources) if sources not in (None, "list") else None)
    if sources == "list":
        rows = [
            (s.name, ", ".join(s.kinds), f"{s.resolution_m:g} m", s.vertical_crs or "", s.licence, s.address)
            for s in known
        ]
        columns = ("name", "delivers", "cells", "heights", "licence", "address")
        print_table("sources, preferred ones first", columns, rows)
        return
    if out is None:
        raise ConfigError("give the folder of the site with --out")
    place = None if lonlat is None else _lonlat(lonlat)
    metres = _metres(radius)
    wanted, remarks = _cameras(camera or [], cameras, place, metres)
    files = {"dem": dem or [], "fuel": [fuel] if fuel else [], "surface": [surface] if surface else []}
    wish = Wish(out.expanduser(), name, place, metres, crs, wanted, files, update)
    with working("looking for data"):
        plan = plan_site(wish, known)
    _print_plan(plan)
    if dry_run:
        return
    if plan.expected_bytes > _ASK_FROM and not yes:
        typer.confirm(f"Fetch {plan.expected_bytes / 1e6:.0f} MB?", abort=True)
    with _ended_by_signals(), progress_bar("fetching, MB") as progress:
        layers, said = carry_out(plan, lambda done, total: progress(done // 1_000_000, total // 1_000_000 + 1))
    for key, layer in layers.items():
        say(f"{key}: {layer.path} ({layer.described})")
    for remark in dict.fromkeys([*plan.remarks, *remarks, *said]):
        warn(remark)
    from ltm_ros.cli.check import report  # here, because help and --dry-run do not need it

    wrong = report(wish.site_file, wish.out / "check.png")
    command = f"ltm run {wish.site_file} --state {wish.out / 'map'} --view"
    typer.echo(f"Next: {command}" if not wrong else f"Correct {wish.site_file}, then: ltm check {wish.site_file}")
    raise typer.Exit(1 if wrong else 0)


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """End the process after Ctrl-C or SIGTERM when files are removed, without waiting for requests in flight."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:
        typer.echo("Interrupted. The same command continues with what was fetched.", err=True)
        sys.stdout.flush()
        os._exit(130)
    finally:
        signal.signal(signal.SIGTERM, before)


def _lonlat(text: str) -> tuple[float, float]:
    lon, lat = numbers(text, "--lonlat", (2,))
    if not (-180 <= lon <= 180 and -84 <= lat <= 84):
        raise ConfigError(f"--lonlat {text}: give longitude in [-180, 180], then latitude in [-84, 84]")
    return lon, lat


def _metres(text: str) -> float:
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(km|m)", text.strip())
    metres = float(found[1]) * (1000 if found[2] == "km" else 1) if found else 0.0
    if not 200 <= metres <= 30_000:
        raise ConfigError(f"--radius {text}: give a length from 200m to 30km, with its unit")
    return metres


def _cameras(
    stated: list[str], listed: Path | None, place: tuple[float, float] | None, radius: float
) -> tuple[list[CameraValues], list[str]]:
    """Return the cameras of the options; of a list, those within the radius."""
    cameras = [parse_camera(text) for text in stated]
    if listed is None:
        return cameras, []
    found, remarks = read_cameras(listed)
    near = found
    if place is not None:
        near = [c for c in found if Geod(ellps="WGS84").inv(*place, c.lon, c.lat)[2] <= radius]
        if not near:
            raise ConfigError(f"{listed}: none of its {len(found)} cameras is within {radius:g} m of the site")
        if len(near) < len(found):
            remarks.append(f"{listed.name}: {len(near)} of {len(found)} cameras are within the radius")
    return cameras + near, remarks


def _print_plan(site: SitePlan) -> None:
    rows = []
    for step in site.steps:
        if step.choice is None:
            rows.append((step.key, ", ".join(map(str, step.own)), "", "", "", ""))
        else:
            source, plan = step.choice.source, step.choice.plan
            cells, size = f"{source.resolution_m:g} m", f"{plan.expected_bytes / 1e6:.1f} MB"
            rows.append((step.key, source.name, cells, str(plan.year or ""), size, source.licence))
    total = f"{site.crs}; {site.expected_bytes / 1e6:.1f} MB to fetch"
    print_table(total, ("raster", "source", ">cells", ">year", ">size", "licence"), rows)
