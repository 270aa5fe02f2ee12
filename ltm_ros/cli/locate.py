"""`ltm locate`: find the place of marks in images, and find a place in the images."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from typer import Option

from ltm_core.base.errors import ConfigError, RegionError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.locating.answer import (
    SHARES,
    LocateResult,
    PlaceView,
    answer,
    as_data,
    as_geojson,
    fuel_at,
    place_name,
    place_views,
    view_data,
)
from ltm_core.locating.locator import Locator, write_posterior
from ltm_core.pictures import to_png
from ltm_core.pictures.locating import location_picture, places_picture
from ltm_core.pictures.trace import map_camera
from ltm_core.storage.disk_io import require_files
from ltm_core.tracing.trace_io import read_photo
from ltm_core.visibility.point_visibility import PointState
from ltm_ros.cli.output import Crs, OptionalDems, Overwrite, numbers, print_table, say, warn
from ltm_ros.cli.scene import Scene, open_scene

FILES = ("locate.png", "locate.json", "locate.geojson", "posterior.tif")
PLACE_FILES = ("places.json", "places.png")


def locate(
    site: Annotated[Path | None, Option(help="Site file with terrain and cameras with poses.")] = None,
    pose: Annotated[
        list[str] | None, Option(metavar="[CAMERA=]FILE", help="Pose file: NAME=FILE, or FILE with --dem. Repeatable.")
    ] = None,
    dem: OptionalDems = None,
    mark: Annotated[
        list[str] | None,
        Option(
            metavar="[CAMERA=]U,V,...",
            help="Pixel, box u_min,v_min,u_max,v_max or polygon (its lower edge). Repeatable.",
        ),
    ] = None,
    smoke: Annotated[bool, Option("--smoke", help="The mark is the lowest visible smoke, above a ridge.")] = False,
    place: Annotated[str | None, Option(help="Reverse query: x,y[,height above ground] in the site's CRS.")] = None,
    lonlat: Annotated[str | None, Option(help="Like --place, in degrees: lon,lat.")] = None,
    photo: Annotated[str | None, Option(metavar="[CAMERA=]FILE", help="Image to draw places on; needs --out.")] = None,
    as_json: Annotated[bool, Option("--json", help="Print JSON instead of tables.")] = False,
    out: Annotated[Path | None, Option(help="Folder for image, JSON, GeoJSON and the posterior.")] = None,
    crs: Crs = None,
    overwrite: Overwrite = False,
) -> None:
    """Find the place of marks in images, with its error ellipses; with --place, find a place in the images."""
    reverse = place is not None or lonlat is not None
    if reverse == bool(mark):
        raise ConfigError("give --mark, or for the reverse query --place or --lonlat")
    if photo is not None and out is None:
        raise ConfigError("--photo is drawn over and written to --out: give that folder")
    if out is not None:
        require_files((out / name for name in (FILES if mark else PLACE_FILES)), overwrite)
    scene = open_scene(site, pose or [], dem, crs)
    if reverse:
        data: Any
        data, files = _show_place(scene, _place(scene, place, lonlat), photo, as_json, out)
    else:
        marks = [scene.named(text, "--mark") for text in mark or []]
        data, files = _show_marks(scene, marks, smoke, as_json, out)
    text = json.dumps(data, indent=2)
    if as_json:
        print(text)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        files[PLACE_FILES[0] if reverse else FILES[1]] = f"{text}\n".encode()
        for name, content in files.items():
            (out / name).write_bytes(content)
        for name in [] if as_json else [*files, *([] if reverse else FILES[3:])]:
            say(f"  {out / name}")


def _show_marks(
    scene: Scene, marks: list[tuple[str, str]], smoke: bool, as_json: bool, out: Path | None
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Locate marks (camera, pixels) and print the answer unless `as_json`; return the answer as data, and the files
    for `out` by name."""
    sightings = [scene.sighting(name, text, smoke) for name, text in marks]
    location = Locator(scene.dem, scene.bend, scene.config).locate(sightings, smoke)
    cameras = list(scene.cameras.values())
    said = answer(location, scene.sight, scene.frame, cameras, scene.prior(), smoke)
    if not as_json:
        _print_answer(said, scene.frame)
    files: dict[str, bytes] = {}
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        files[FILES[0]] = to_png(_picture(scene, said, list(dict.fromkeys(name for name, _ in marks))))
        files[FILES[2]] = (json.dumps(as_geojson(said, scene.frame)) + "\n").encode()
        write_posterior(out / FILES[3], said.location.posterior, scene.frame)
    return as_data(said, scene.frame), files


def _picture(scene: Scene, said: LocateResult, marked_by: list[str]) -> Any:
    cameras = [map_camera(scene.camera(name)) for name in marked_by]
    ellipses = [(f"{share:.0%}", ellipse) for share, ellipse in zip(SHARES, said.ellipses, strict=True)]
    place = said.name
    heading = (
        f"Marked by {', '.join(marked_by)}: {place.lon:.5f}, {place.lat:.5f} (longitude, latitude); "
        f"{place.x:.0f} m E, {place.y:.0f} m N in {place.crs}{f'; MGRS {place.mgrs}' if place.mgrs else ''}"
    )
    origin = (scene.frame.x_origin, scene.frame.y_origin)
    return location_picture(scene.dem, said.location.posterior, ellipses, cameras, origin, heading)


def _print_answer(said: LocateResult, frame: SiteFrame) -> None:
    """Print the place and whether the cameras agree."""
    name, posterior = said.name, said.location.posterior
    x, y = posterior.likeliest
    rows = [
        (f"mean place, {name.crs}", f"{name.x:.1f}, {name.y:.1f}"),
        ("most probable place", f"{x + frame.x_origin:.1f}, {y + frame.y_origin:.1f}"),
        ("longitude, latitude", f"{name.lon:.6f}, {name.lat:.6f}"),
        ("MGRS", name.mgrs or "none at this latitude"),
    ]
    if name.elevation is not None:
        rows.append(("elevation", f"{name.elevation:.0f} m, sigma {said.elevation_sigma:.0f} m"))
    for share, ellipse in zip(SHARES, said.ellipses, strict=True):
        axes = f"{ellipse.major:,.0f} m by {ellipse.minor:,.0f} m (half axes), long axis {ellipse.azimuth_deg:.0f}°"
        rows.append((f"ellipse, {share:.0%}", axes))
    if len(modes := posterior.modes) > 1:
        parts = (
            f"{mode.share:.0%} at {mode.centre[0] + frame.x_origin:.0f}, {mode.centre[1] + frame.y_origin:.0f}"
            for mode in modes[:4]
        )
        rows.append((f"{len(modes)} separate areas", "\n".join(parts)))
    if said.smoke and said.location.lift > 1:
        rows.append(("hidden below", f"{said.location.lift:.0f} m above the ground there (mean)"))
    if said.fuel is not None:
        rows.append(("fuel (prior map)", f"{said.fuel['name']} ({said.fuel['code']})"))
    print_table("base of the smoke" if said.smoke else "on the ground", ("", ""), rows)
    agreement = said.location.agreement
    if agreement is not None and not agreement.agree:
        shares = ", ".join(f"{camera} {share:.0%}" for camera, share in agreement.suspicion.items())
        warn(f"The cameras disagree. Probability of each to be the wrong one: {shares}. Check their poses.")
    _print_views(said.views)


def _print_views(views: Sequence[PlaceView]) -> None:
    """Print whether each camera sees a place, and in which direction it is."""
    rows = []
    for view in views:
        state = view.state.name.lower()
        if view.hidden_by is not None:
            state += f": visible from {view.lift:.0f} m above it"
        pixel = "outside" if view.pixel is None else f"{view.pixel[0]:.0f}, {view.pixel[1]:.0f}"
        angles = (f"{view.azimuth_deg:.2f}°", f"{view.pitch_deg:+.2f}°", f"{view.hfov_deg:.0f}°")
        rows.append((view.camera, f"{view.distance / 1000:.2f} km", *angles, pixel, state))
    columns = ("camera", ">distance", ">bearing", ">pitch", ">field of view", ">pixel", "state")
    print_table("visibility from the cameras", columns, rows)


def _show_place(
    scene: Scene, target: Float64Array, photo: str | None, as_json: bool, out: Path | None
) -> tuple[list[dict[str, Any]], dict[str, bytes]]:
    """Print where cameras see a place unless `as_json`; return that as data, and the place drawn over a photo."""
    views = place_views(scene.sight, list(scene.cameras.values()), target)
    fuel = fuel_at(scene.prior(), float(target[0]), float(target[1]))
    known = place_name(scene.frame, *(float(v) for v in target))
    seen_by = [view_data(view, scene.frame) for view in views]
    data = {"name": "place", "place": vars(known), "fuel": fuel, "cameras": seen_by}
    if not as_json:
        say(
            f"{known.x:.1f}, {known.y:.1f}, {target[2]:.1f} m; {known.lon:.6f}, {known.lat:.6f}; "
            f"{known.mgrs or ''}" + ("" if fuel is None else f"; fuel {fuel['name']}")
        )
        _print_views(views)
    files = {}
    if photo is not None:
        name, path = scene.named(photo, "--photo")
        camera = scene.camera(name)
        seen = scene.sight.visible(camera.camera, camera.pose, target[None])
        state, (u, v) = PointState(int(seen.states[0])), (float(value) for value in seen.pixels[0])
        drawn = [] if state is PointState.OUTSIDE else [("place", (u, v), state)]
        files[PLACE_FILES[1]] = to_png(places_picture(read_photo(Path(path), camera.camera), drawn))
    return [data], files


def _place(scene: Scene, place: str | None, lonlat: str | None) -> Float64Array:
    """Return the place (3,) in the map frame. Raises ConfigError, RegionError."""
    if not scene.cameras:
        raise ConfigError(f"no camera has calibration and pose ({', '.join(scene.skipped)}: from topics); give --pose")
    frame = scene.frame
    if place is not None:
        values = numbers(place, "--place", (2, 3))
        x, y = values[0] - frame.x_origin, values[1] - frame.y_origin
    else:
        values = numbers(lonlat or "", "--lonlat", (2, 3))
        x, y = (float(v) for v in frame.from_lonlat(values[0], values[1]))
    ground = float(scene.dem.elevation_at(x, y))
    if not np.isfinite(ground):
        covered = scene.dem.levels[-1].geometry.translated(frame.x_origin, frame.y_origin)
        raise RegionError(
            f"({x + frame.x_origin:.0f}, {y + frame.y_origin:.0f}) in {frame.crs} has no terrain; the DEM covers "
            f"{covered.described()}"
        )
    return np.array([x, y, ground + (values[2] if len(values) == 3 else 0.0)])
