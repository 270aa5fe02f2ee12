"""How high the camera of a photo stood: stated, by barometer, by altitude, or above the terrain."""

from __future__ import annotations

import math

import numpy as np

from ltm_core.base.errors import PoseError
from ltm_core.cameras.camera_config import PartialPose
from ltm_core.cameras.plausibility import doubt_of_height
from ltm_ros.recordings.importing.assumptions import Assumptions, Surroundings
from ltm_ros.recordings.importing.photo import Photo
from ltm_ros.recordings.importing.sensed import Sensed

_SUSPECT_HEIGHT = 25.0
_MAYBE_ELLIPSOIDAL = "if all photos are off alike, their altitudes are ellipsoidal: give --geoid-undulation-m"


def height_of(
    photo: Photo,
    known: PartialPose,
    x: float,
    y: float,
    site: Surroundings,
    assumed: Assumptions,
    notes: list[str],
    found: dict[str, float],
) -> float:
    """Its z in the map frame at (x, y); `found` gets the sigma of what sensors told, `notes` what was assumed.

    Raises PoseError under the ground, and where nothing tells a height.
    """
    dem = site.dem
    ground = float(dem.elevation_at(x, y)) if dem is not None else math.nan
    if known.z is not None:
        return _stated_height(photo, known.z, ground, notes)
    if known.height_above_ground is None:
        sensed = _climbed(photo.sensed, site, assumed)
        if sensed is None:
            sensed = _altitude(photo.sensed, ground, assumed, notes)
        if sensed is not None:
            z, sigma, what = sensed
            if not z < ground:  # also where the ground is not known
                found["height_sigma"] = sigma
                return z
            under = f"{what} {z:.1f} m is {ground - z:.1f} m under the terrain"
            _refuse_in_flight(photo, assumed, under)
            notes.append(f"{under}: taken as {assumed.height_above_ground:g} m above it; {_MAYBE_ELLIPSOIDAL}")
        else:
            _refuse_in_flight(photo, assumed, "its altitude is not known")
    above = known.height_above_ground
    if above is None:
        above, found["height_sigma"] = assumed.height_above_ground, assumed.ground_sigma
        if photo.sensed.altitude is None:
            notes.append(f"height is not known: taken as {above:g} m above the terrain")
    if math.isnan(ground):
        why = "there is no DEM (give --site)" if dem is None else "it stands outside the DEM"
        raise PoseError(f"{photo.path} at map ({x:.1f}, {y:.1f}): height above ground does not help, {why}; give its z")
    return ground + above


def _refuse_in_flight(photo: Photo, assumed: Assumptions, why: str) -> None:
    """A drone tells by how much it has climbed: it is not at eye height above the terrain. Raises PoseError."""
    climb = photo.sensed.climb
    if climb is not None and photo.sensed.walk is None and assumed.start_height is None:
        raise PoseError(
            f"{photo.path}: {why}, and {photo.sensed.source} tells {climb:.1f} m above the place of take-off alone: "
            "give --start-height, how high this is in the DEM's vertical datum"
        )


def _altitude(sensed: Sensed, ground: float, assumed: Assumptions, notes: list[str]) -> tuple[float, float, str] | None:
    """Height in the DEM's datum by an altitude, its sigma, and what to call it; None where there is none."""
    if sensed.altitude is None:
        return None
    undulation = assumed.geoid_undulation
    if sensed.ellipsoidal and undulation is None:
        notes.append(
            f"{sensed.source}'s altitudes are above the WGS 84 ellipsoid, and the geoid's height is not known: taken "
            f"is {assumed.height_above_ground:g} m above the terrain; --geoid-undulation-m makes use of them"
        )
        return None
    z, what = sensed.altitude - (undulation or 0.0), f"{sensed.source} altitude"
    if z > ground + _SUSPECT_HEIGHT:
        notes.append(f"{what} {z:.1f} m is {z - ground:.1f} m above the terrain: {_MAYBE_ELLIPSOIDAL}")
    return z, sensed.altitude_sigma or assumed.altitude_sigma, what


def _climbed(sensed: Sensed, site: Surroundings, assumed: Assumptions) -> tuple[float, float, str] | None:
    """Height by the barometer: weather moves it by tens of metres, so only what it climbed since the start counts.

    The start is as high as the user says, or else what sets the whole walk at eye height above the terrain, in the
    median: a fix that is metres off stands on other ground.
    """
    if sensed.climb is None:
        return None
    what = f"{sensed.source} barometer's height"
    if assumed.start_height is not None:
        return assumed.start_height + sensed.climb, assumed.climb_sigma, what
    if sensed.walk is None or site.dem is None:
        return None
    walk = sensed.walk
    ground = site.dem.elevation_at(*site.frame.from_lonlat(walk.lon, walk.lat))
    starts = (ground - walk.climb)[np.isfinite(ground)]
    if not len(starts):
        return None
    start = float(np.median(starts)) + assumed.height_above_ground
    return start + sensed.climb, math.hypot(assumed.ground_sigma, assumed.climb_sigma), what


def _stated_height(photo: Photo, z: float, ground: float, notes: list[str]) -> float:
    doubt = doubt_of_height(z, ground)
    if z <= ground:
        raise PoseError(f"{photo.path}: {doubt}")
    if doubt is not None:
        notes.append(doubt)
    return z
