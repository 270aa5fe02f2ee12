"""`ltm check`: check a site file and draw what it describes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_ros.cli.output import Overwrite, print_findings

if TYPE_CHECKING:
    from rich.console import Console

    from ltm_core.base.errors import SiteFinding
    from ltm_core.base.types import RgbImage
    from ltm_core.site.site_check import SiteCheck

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

    from ltm_core.storage.disk_io import require_files

    if out is not None:
        require_files([out], overwrite)
    raise typer.Exit(1 if report(Console(), site, out, bag, only or ()) else 0)


def report(
    console: Console, site: Path, out: Path | None = None, bag: Path | None = None, only: Sequence[str] = ()
) -> int:
    """Print the findings about a site, draw it to `out`, and return the number of errors."""
    from ltm_core.base.errors import SiteVerdict
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
    from ltm_core.base.errors import SiteVerdict

    styles = {SiteVerdict.OK: "green", SiteVerdict.DOUBTFUL: "yellow", SiteVerdict.WRONG: "bold red"}
    order = list(dict.fromkeys(finding.area for finding in findings))
    sorted_by_area = sorted(findings, key=lambda one: order.index(one.area))
    rows = [(one.area, str(one.verdict), styles[one.verdict], one.name, one.said) for one in sorted_by_area]
    print_findings(console, rows)


def _add_recorded(found: SiteCheck, bag: Path) -> None:
    """Add the recorded views of cameras that have no pose in the site file."""
    from ltm_core.base.errors import LtmError, SiteFinding
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
    import math
    from dataclasses import replace

    from ltm_core.base.errors import LtmError
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
