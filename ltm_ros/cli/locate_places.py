"""Find places of the map in the images of cameras, and print the tables of `ltm locate`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from ltm_core.base.errors import ConfigError, RegionError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.locating.answer import SHARES, LocateResult, PlaceView, fuel_at, place_name, place_views, view_data
from ltm_ros.cli.locate_cameras import named, numbers
from ltm_ros.cli.output import print_table

if TYPE_CHECKING:
    from ltm_ros.cli.locate_cameras import LocatingScene


def show_answer(said: LocateResult, frame: SiteFrame, console: Console) -> None:
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
    modes = posterior.modes
    if len(modes) > 1:
        parts = (
            f"{mode.share:.0%} at {mode.centre[0] + frame.x_origin:.0f}, {mode.centre[1] + frame.y_origin:.0f}"
            for mode in modes[:4]
        )
        rows.append((f"{len(modes)} separate areas", "\n".join(parts)))
    if said.smoke and said.location.lift > 1:
        rows.append(("hidden below", f"{said.location.lift:.0f} m above the ground there (mean)"))
    if said.fuel is not None:
        rows.append(("fuel (prior map)", f"{said.fuel.name} ({said.fuel.code})"))
    print_table(console, "base of the smoke" if said.smoke else "on the ground", ("", ""), rows)
    agreement = said.location.agreement
    if agreement is not None and not agreement.agree:
        shares = ", ".join(f"{camera} {share:.0%}" for camera, share in agreement.suspicion.items())
        console.print(
            f"[yellow]The cameras disagree. Probability of each to be the wrong one: {shares}. Check their poses.",
            highlight=False,
        )
    print_views(console, said.views)


def print_views(console: Console, views: Sequence[PlaceView]) -> None:
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
    print_table(console, "visibility from the cameras", columns, rows)


def show_places(
    scene: LocatingScene,
    place: str | None,
    lonlat: str | None,
    photo: str | None,
    as_json: bool,
    out: Path | None,
    console: Console,
) -> None:
    """Print where cameras see places; draw them over a camera's photo. Raises ConfigError, RegionError, PoseError."""
    if not scene.cameras:
        raise ConfigError(f"no camera has calibration and pose ({', '.join(scene.skipped)}: from topics); give --pose")
    target = _place(scene, place, lonlat)
    drawn = None if photo is None else named(photo, "--photo", scene)
    posed = [camera.posed for camera in scene.cameras.values()]
    views = place_views(scene.sight, posed, target)
    fuel = fuel_at(scene.prior, float(target[0]), float(target[1]))
    known = place_name(scene.frame, *(float(v) for v in target))
    data = [
        {
            "name": "place",
            "place": vars(known),
            "fuel": None if fuel is None else vars(fuel),
            "cameras": [view_data(view, scene.frame) for view in views],
        }
    ]
    if not as_json:
        console.print(
            f"{known.x:.1f}, {known.y:.1f}, {target[2]:.1f} m; {known.lon:.6f}, {known.lat:.6f}; "
            f"{known.mgrs or ''}" + ("" if fuel is None else f"; fuel {fuel.name}"),
            highlight=False,
        )
        print_views(console, views)
    if as_json:
        print(json.dumps(data, indent=2))
    if out is None:
        return
    out.mkdir(parents=True, exist_ok=True)
    (out / "places.json").write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
    written = [out / "places.json"]
    if drawn is not None:
        written.append(out / "places.png")
        _draw(scene, drawn[0], target, Path(drawn[1]), written[-1])
    if not as_json:
        for path in written:
            console.print(f"  {path}", highlight=False)


def _draw(scene: LocatingScene, name: str, place: Float64Array, photo: Path, path: Path) -> None:
    from ltm_core.pictures import to_png
    from ltm_core.pictures.locating import places_picture
    from ltm_core.tracing.trace_io import read_photo
    from ltm_core.visibility.point_visibility import PointState

    camera = scene.camera(name)
    seen = scene.sight.visible(camera.camera, camera.pose, place[None])
    state, (u, v) = PointState(int(seen.states[0])), (float(value) for value in seen.pixels[0])
    drawn = [] if state is PointState.OUTSIDE else [("place", (u, v), state)]
    path.write_bytes(to_png(places_picture(read_photo(photo, camera.camera), drawn)))


def _place(scene: LocatingScene, place: str | None, lonlat: str | None) -> Float64Array:
    """Return the place (3,) in the map frame."""
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
    above = values[2] if len(values) == 3 else 0.0
    return np.array([x, y, ground + above])
