"""`ltm locate`: find the place of marks in images, and find a place in the images."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_core.base.errors import ConfigError
from ltm_core.storage.disk_io import require_files
from ltm_ros.cli.output import Overwrite

if TYPE_CHECKING:
    from ltm_core.locating.answer import LocateResult
    from ltm_core.locating.sighting import Sighting
    from ltm_ros.cli.locate_cameras import LocatingScene

FILES = ("locate.png", "locate.json", "locate.geojson", "posterior.tif")


def locate(
    site: Annotated[Path | None, typer.Option(help="Site file with terrain and cameras with poses.")] = None,
    pose: Annotated[
        list[str] | None,
        typer.Option(metavar="[CAMERA=]FILE", help="Pose file of a camera: NAME=FILE, or FILE with --dem. Repeatable."),
    ] = None,
    dem: Annotated[
        list[Path] | None, typer.Option(help="Elevation raster for --pose; repeat for coarser surrounding rasters.")
    ] = None,
    mark: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[CAMERA=]U,V,...",
            help="Mark: a pixel, a box u_min,v_min,u_max,v_max, or a polygon; lower edges count. Repeatable.",
        ),
    ] = None,
    smoke: Annotated[
        bool, typer.Option("--smoke", help="The mark is the lowest visible smoke; its base may be behind a ridge.")
    ] = False,
    place: Annotated[
        str | None, typer.Option(help="Reverse query: x,y in the site's CRS, or x,y,height above ground.")
    ] = None,
    lonlat: Annotated[str | None, typer.Option(help="Like --place, in degrees: lon,lat.")] = None,
    photo: Annotated[
        str | None, typer.Option(metavar="[CAMERA=]FILE", help="Image of the camera to draw places over; needs --out.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for image, JSON, GeoJSON and the posterior.")] = None,
    crs: Annotated[str | None, typer.Option(help="With --dem: CRS of a raster that states none.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Find the place of marks in images, with its error ellipses; with --place, find a place in the images."""
    from rich.console import Console

    from ltm_ros.cli.locate_cameras import marked, named, of_poses, of_site

    reverse = place is not None or lonlat is not None
    if reverse == bool(mark):
        raise ConfigError("give --mark, or for the reverse query --place or --lonlat")
    if photo is not None and out is None:
        raise ConfigError("--photo is drawn over and written to --out: give that folder")
    if out is not None:
        require_files((out / name for name in (FILES if mark else ("places.png", "places.json"))), overwrite)
    if site is not None:
        scene = of_site(site, pose or [])
    elif pose:
        scene = of_poses(pose, dem or [], crs)
    else:
        raise ConfigError("give --site S.yaml, or --pose P.yaml with --dem D.tif")
    console = Console()
    if reverse:
        from ltm_ros.cli.locate_places import show_places

        show_places(scene, place, lonlat, photo, as_json, out, console)
        return
    marks = [named(text, "--mark", scene) for text in mark or []]
    sightings = [marked(scene, name, text, smoke) for name, text in marks]
    said = _answer(scene, sightings, smoke)
    if as_json:
        from ltm_core.locating.answer import as_data

        print(json.dumps(as_data(said, scene.frame), indent=2))
    else:
        from ltm_ros.cli.locate_places import show_answer

        show_answer(said, scene.frame, console)
    if out is not None:
        written = _write(out, said, scene, [name for name, _ in marks])
        if not as_json:
            for path in written:
                console.print(f"  {path}", highlight=False)


def _answer(scene: LocatingScene, sightings: list[Sighting], smoke: bool) -> LocateResult:
    from ltm_core.locating.answer import answer
    from ltm_core.locating.locator import Locator

    location = Locator(scene.dem, scene.bend, scene.config).locate(sightings, smoke)
    posed = [camera.posed for camera in scene.cameras.values()]
    return answer(location, scene.sight, scene.frame, posed, scene.prior, smoke)


def _write(out: Path, said: LocateResult, scene: LocatingScene, marked: list[str]) -> list[Path]:
    from ltm_core.locating.answer import SHARES, as_data, as_geojson
    from ltm_core.locating.locator import write_posterior
    from ltm_core.pictures import MapCamera, to_png
    from ltm_core.pictures.locating import location_picture

    out.mkdir(parents=True, exist_ok=True)
    files = [out / name for name in FILES]
    cameras = []
    for name in dict.fromkeys(marked):
        camera = scene.camera(name)
        x, y, _ = (float(v) for v in camera.pose.position)
        cameras.append(MapCamera(name, camera.camera, (x, y), camera.pose.angles_deg[0]))
    ellipses = [(f"{share:.0%}", ellipse) for share, ellipse in zip(SHARES, said.ellipses, strict=True)]
    offset = (scene.frame.x_origin, scene.frame.y_origin)
    place = said.name
    heading = (
        f"Marked by {', '.join(dict.fromkeys(marked))}: {place.lon:.5f}, {place.lat:.5f} (longitude, latitude); "
        f"{place.x:.0f} m E, {place.y:.0f} m N in {place.crs}{f'; MGRS {place.mgrs}' if place.mgrs else ''}"
    )
    picture = location_picture(scene.dem, said.location.posterior, ellipses, cameras, offset, heading)
    files[0].write_bytes(to_png(picture))
    files[1].write_text(json.dumps(as_data(said, scene.frame), indent=2) + "\n", encoding="utf-8")
    files[2].write_text(json.dumps(as_geojson(said, scene.frame)) + "\n", encoding="utf-8")
    write_posterior(files[3], said.location.posterior, scene.frame)
    return files
