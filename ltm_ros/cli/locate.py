"""`ltm locate`: find the place of marks in images, and find a place in the images."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_ros.cli.output import Overwrite

if TYPE_CHECKING:
    from ltm_core.locating.answer import LocateResult
    from ltm_core.locating.settings import LocatingConfig
    from ltm_core.locating.sighting import Sighting
    from ltm_ros.cli.locate_cameras import LocatingScene

FILES = ("locate.png", "locate.json", "locate.geojson", "posterior.tif")


def locate(
    site: Annotated[Path | None, typer.Option(help="Site file with terrain and cameras with poses.")] = None,
    pose: Annotated[
        list[str] | None,
        typer.Option(help="Pose file of a camera: NAME=FILE, or FILE with --dem. Repeatable."),
    ] = None,
    dem: Annotated[
        list[Path] | None, typer.Option(help="Elevation raster for --pose; repeat for coarser surrounding rasters.")
    ] = None,
    camera: Annotated[
        list[str] | None, typer.Option(help="Camera of a mark; give one for each mark, in order.")
    ] = None,
    pixel: Annotated[list[str] | None, typer.Option(help="Mark: a pixel, u,v. Repeatable.")] = None,
    box: Annotated[
        list[str] | None, typer.Option(help="Mark: a box u_min,v_min,u_max,v_max; its lower edge is used. Repeatable.")
    ] = None,
    polygon: Annotated[
        list[str] | None, typer.Option(help="Mark: a polygon u,v,u,v,u,v,...; its lower edge is used. Repeatable.")
    ] = None,
    mask: Annotated[
        list[str] | None, typer.Option(help="Mask NAME=PNG: marks ignore the non-black pixels of that camera.")
    ] = None,
    smoke: Annotated[
        bool, typer.Option("--smoke", help="The mark is the lowest visible smoke; its base may be behind a ridge.")
    ] = False,
    place: Annotated[
        str | None, typer.Option(help="Reverse query: x,y in the site's CRS, or x,y,height above ground.")
    ] = None,
    lonlat: Annotated[str | None, typer.Option(help="Like --place, in degrees: lon,lat.")] = None,
    points: Annotated[
        Path | None, typer.Option(help="CSV of control points to draw over --photo: id, x, y, z, u, v.")
    ] = None,
    first_pixel: Annotated[float, typer.Option(help="With --points: coordinate of the first pixel's centre.")] = 0.0,
    photo: Annotated[Path | None, typer.Option(help="Image of the camera to draw places over; needs --out.")] = None,
    dem_sigma: Annotated[
        float | None, typer.Option(help="Standard deviation of terrain heights in metres.", min=0)
    ] = None,
    plume_height: Annotated[float | None, typer.Option(help="With --smoke: mean height of plumes in metres.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for image, JSON, GeoJSON and the posterior.")] = None,
    crs: Annotated[str | None, typer.Option(help="With --dem: CRS of a raster that states none.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Find the place of marks in images, with its error ellipses; with --place, find a place in the images."""
    from rich.console import Console

    from ltm_core.base.errors import ConfigError
    from ltm_core.storage.disk_io import require_files
    from ltm_ros.cli.locate_cameras import hidden_by, marked, of_poses, of_site

    reverse = place is not None or lonlat is not None or points is not None
    marks = [*(pixel or []), *(box or []), *(polygon or [])]
    if reverse == bool(marks):
        raise ConfigError(
            "give a mark (--pixel, --box or --polygon), or for the reverse query --place, --lonlat or --points"
        )
    if photo is not None and out is None:
        raise ConfigError("--photo is drawn over and written to --out: give that folder")
    if out is not None:
        require_files((out / name for name in (FILES if marks else ("places.png", "places.json"))), overwrite)
    if site is not None:
        scene = of_site(site, pose or [])
    elif pose:
        scene = of_poses(pose, dem or [], crs)
    else:
        raise ConfigError("give --site S.yaml, or --pose P.yaml with --dem D.tif")
    console = Console()
    if reverse:
        from ltm_ros.cli.locate_places import show_places

        show_places(scene, place, lonlat, points, first_pixel, photo, camera or [], as_json, out, console)
        return
    changed = {"dem_sigma": dem_sigma, "plume_height": plume_height}
    config = scene.config.model_validate(
        scene.config.model_dump() | {key: value for key, value in changed.items() if value is not None}
    )
    kinds = [kind for kind in (pixel, box, polygon) if kind]
    if len(kinds) > 1:
        raise ConfigError("give marks of one kind; --polygon also takes a pixel (one point) or a box (four points)")
    names = camera or (list(scene.cameras) if len(scene.cameras) == 1 else [])
    if len(names) != len(marks):
        raise ConfigError(
            f"{len(marks)} marks need as many --camera, in the same order; got {', '.join(names) or 'none'}"
        )
    masks = hidden_by(scene, mask or [])
    sightings = [marked(scene, name, text, config, smoke, masks) for name, text in zip(names, marks, strict=True)]
    said = _answer(scene, config, sightings, smoke)
    if as_json:
        import json

        from ltm_core.locating.answer import as_data

        print(json.dumps(as_data(said, scene.frame), indent=2))
    else:
        from ltm_ros.cli.locate_places import show_answer

        show_answer(said, scene.frame, console)
    if out is not None:
        written = _write(out, said, scene, names)
        if not as_json:
            for path in written:
                console.print(f"  {path}", highlight=False)


def _answer(scene: LocatingScene, config: LocatingConfig, sightings: list[Sighting], smoke: bool) -> LocateResult:
    from ltm_core.locating.answer import answer
    from ltm_core.locating.locator import Locator

    location = Locator(scene.dem, scene.bend, config).locate(sightings, smoke)
    posed = [camera.posed for camera in scene.cameras.values()]
    return answer(location, scene.sight, scene.frame, posed, scene.prior, smoke)


def _write(out: Path, said: LocateResult, scene: LocatingScene, marked: list[str]) -> list[Path]:
    import json

    from ltm_core.locating.answer import SHARES, as_data, as_geojson
    from ltm_core.locating.posterior import write_posterior
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
    titles = (f"seen by {', '.join(dict.fromkeys(marked))}", said.name.mgrs or "closely")
    picture = location_picture(scene.dem, said.location.posterior, ellipses, cameras, offset, titles)
    files[0].write_bytes(to_png(picture))
    files[1].write_text(json.dumps(as_data(said, scene.frame), indent=2) + "\n", encoding="utf-8")
    files[2].write_text(json.dumps(as_geojson(said, scene.frame)) + "\n", encoding="utf-8")
    write_posterior(files[3], said.location.posterior, scene.frame)
    return files
