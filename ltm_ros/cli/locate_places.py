"""The way back of `ltm locate`: places of the map in the cameras' pictures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ltm_core.errors import ConfigError, RegionError
from ltm_core.locating.answer import fuel_at, place_name, view_data
from ltm_core.locating.place import place_views
from ltm_core.types import Float64Array
from ltm_ros.cli.locate_tables import views_table
from ltm_ros.cli.number_lists import numbers

if TYPE_CHECKING:
    from rich.console import Console

    from ltm_ros.cli.locate_cameras import LocatingScene


def show_places(
    scene: LocatingScene,
    place: str | None,
    lonlat: str | None,
    points: Path | None,
    first_pixel: float,
    photo: Path | None,
    cameras: list[str],
    as_json: bool,
    out: Path | None,
    console: Console,
) -> None:
    """Print where cameras see places; draw them over a camera's photo. Raises ConfigError, RegionError, PoseError."""
    chosen = [scene.camera(name) for name in cameras] if cameras else list(scene.cameras.values())
    if not chosen:
        raise ConfigError(f"no camera has calibration and pose ({', '.join(scene.skipped)} come as topics): --pose")
    names, places, marked = _places(scene, place, lonlat, points, first_pixel)
    posed = [camera.posed for camera in chosen]
    data = []
    for name, target in zip(names, places, strict=True):
        views = place_views(scene.sight, posed, target)
        fuel = fuel_at(scene.prior, float(target[0]), float(target[1]))
        known = place_name(scene.frame, *(float(v) for v in target))
        data.append(
            {
                "name": name,
                "place": vars(known),
                "fuel": None if fuel is None else vars(fuel),
                "cameras": [view_data(view, scene.frame) for view in views],
            }
        )
        if not as_json:
            console.print(
                f"{name}: {known.x:.1f}, {known.y:.1f}, {target[2]:.1f} m; {known.lon:.6f}, {known.lat:.6f}; "
                f"{known.mgrs or ''}" + ("" if fuel is None else f"; fuel {fuel.name}"),
                highlight=False,
            )
            console.print(views_table(views))
    if as_json:
        print(json.dumps(data, indent=2))
    if out is None:
        return
    out.mkdir(parents=True, exist_ok=True)
    (out / "places.json").write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
    written = [out / "places.json"]
    if photo is not None:
        if len(chosen) != 1:
            raise ConfigError(f"--photo is of one camera: name it with --camera, one of {', '.join(scene.cameras)}")
        written.append(out / "places.png")
        _draw(scene, chosen[0].name, names, places, marked, photo, written[-1])
    if not as_json:
        for path in written:
            console.print(f"  {path}", highlight=False)


def _draw(
    scene: LocatingScene,
    name: str,
    names: list[str],
    places: Float64Array,
    marked: Float64Array | None,
    photo: Path,
    path: Path,
) -> None:
    from ltm_core.pictures import to_png
    from ltm_core.pictures.locating import places_picture
    from ltm_core.tracing.trace_io import read_photo
    from ltm_core.visibility.point_visibility import PointState

    camera = scene.camera(name)
    seen = scene.sight.visible(camera.camera, camera.pose, places)
    drawn = [
        (text, (float(pixel[0]), float(pixel[1])), PointState(int(state)))
        for text, pixel, state in zip(names, seen.pixels, seen.states, strict=True)
        if state != PointState.OUTSIDE
    ]
    kept = None if marked is None else marked[seen.states != PointState.OUTSIDE]
    path.write_bytes(to_png(places_picture(read_photo(photo, camera.camera), drawn, kept)))


def _places(
    scene: LocatingScene, place: str | None, lonlat: str | None, points: Path | None, first_pixel: float
) -> tuple[list[str], Float64Array, Float64Array | None]:
    """Names, places (N, 3) in the map frame, and where they were marked (N, 2), of control points."""
    frame = scene.frame
    if points is not None:
        from ltm_core.pose_estimation.resection_io import read_control_points

        read = read_control_points(points, frame, first_pixel)
        return list(read.names), np.array(read.places), np.array(read.pixels)
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
            f"no terrain is known at ({x + frame.x_origin:.0f}, {y + frame.y_origin:.0f}) in {frame.crs}; the DEM "
            f"covers {covered.described()}"
        )
    above = values[2] if len(values) == 3 else 0.0
    return ["place"], np.array([[x, y, ground + above]]), None
