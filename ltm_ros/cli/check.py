"""`ltm check`: check a site before it runs, and draw it."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from ltm_core.base.errors import LtmError, SiteFinding, SiteVerdict
from ltm_core.base.types import RgbImage
from ltm_core.pictures import to_png
from ltm_core.pictures.trace import map_camera, site_picture
from ltm_core.raster.dem import Dem
from ltm_core.site.camera_check import check_views
from ltm_core.site.site import Site
from ltm_core.site.site_check import SiteCheck
from ltm_core.storage.disk_io import require_files
from ltm_core.visibility.point_visibility import PointVisibility
from ltm_core.visibility.viewshed import viewshed
from ltm_ros.cli.output import OnlyCameras, Overwrite, print_findings, say, working
from ltm_ros.launching.site_check import examine
from ltm_ros.recordings.recorded_run import recorded_views
from ltm_ros.recordings.replay.offline import Selection

_CELLS = 100_000
"""Number of DEM cells at which the cameras' views are evaluated; takes 1 to 2 s per camera."""
_STYLES = {SiteVerdict.OK: "green", SiteVerdict.DOUBTFUL: "yellow", SiteVerdict.WRONG: "bold red"}


def check(
    site: Annotated[Path, Argument(help="Site file (YAML).")],
    out: Annotated[Path | None, Option("--out", "-o", help="PNG of terrain, views, seen ground and prior map.")] = None,
    bag: Annotated[Path | None, Option(help="Recording with the views of cameras whose poses are topics.")] = None,
    only: OnlyCameras = None,
    overwrite: Overwrite = False,
) -> None:
    """Check a site: CRS, terrain, cameras, prior, networks, parameters, folders. Exit code 1 if it has errors."""
    if out is not None:
        require_files([out], overwrite)
    raise typer.Exit(1 if report(site, out, bag, only or ()) else 0)


def report(path: Path, out: Path | None = None, bag: Path | None = None, only: Sequence[str] = ()) -> int:
    """Print the findings about a site, draw it to `out`, and return the number of errors."""
    with working("checking"):
        found = examine(path, {"cameras": only})
        site, dem = found.site, found.dem
        if site is not None and dem is not None and bag is not None:
            _add_recorded(found, site, dem, bag)
    order = list(dict.fromkeys(finding.area for finding in found.findings))
    by_area = sorted(found.findings, key=lambda one: order.index(one.area))
    print_findings((one.area, str(one.verdict), _STYLES[one.verdict], one.name, one.said) for one in by_area)
    if site is not None and dem is not None and out is not None:
        with working("drawing"):
            out.parent.mkdir(parents=True, exist_ok=True)
            out.write_bytes(to_png(_picture(found, site, dem)))
        say(f"  {out}")
    wrong, doubtful = len(found.wrong), sum(one.verdict is SiteVerdict.DOUBTFUL for one in found.findings)
    typer.echo(f"{wrong} errors, {doubtful} warnings" if wrong or doubtful else "no errors")
    return wrong


def _add_recorded(found: SiteCheck, site: Site, dem: Dem, bag: Path) -> None:
    """Add the recorded views of cameras that have no pose in the site file."""
    try:
        Selection.open(bag, site)
        views = recorded_views(bag, site)
    except LtmError as error:
        found.findings.append(SiteFinding.of("recording", bag.name, error))
        return
    there = {view.name for view in found.views}
    added = [view for view in views if view.name not in there]
    found.findings += check_views(added, dem)
    found.views += added


def _picture(found: SiteCheck, site: Site, dem: Dem) -> RgbImage:
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
    prior = found.prior and replace(found.prior, geometry=site.in_map(found.prior.geometry))
    said = [f"Site {site.name}, {site.crs}."]
    if names:
        said.append(
            f"Pixels vote up to {farthest / 1000:g} km. Sectors are horizontal fields of view; their length has no "
            "meaning."
        )
    if absent := [name for name in site.cameras if name not in names]:
        said.append(f"Pose from a topic: {', '.join(absent)}.")
    return site_picture(dem, cameras, seen, prior, site.origin, " ".join(said))
