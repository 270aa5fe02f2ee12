"""Camera, pose and stamp of one photo, from its row in the pose file, its EXIF and the site."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import UTC, datetime

from ltm_core.camera import Camera
from ltm_core.dem import Dem
from ltm_core.errors import CameraError, PoseError, RecordingError
from ltm_core.geodesy import SiteFrame
from ltm_core.plausibility import doubt_of_height
from ltm_core.pose import Pose
from ltm_ros.importer.photo import Photo
from ltm_ros.importer.pose_file import PhotoPose

_NS_PER_S = 1_000_000_000
_SUSPECT_HEIGHT = 25.0
_MAYBE_ELLIPSOIDAL = "if all photos are off alike, their altitudes are ellipsoidal: give --geoid-undulation-m"


@dataclass(frozen=True)
class Assumptions:
    """What to take where neither pose file nor EXIF says it. Angles in degrees, lengths in metres.

    `geoid_undulation`: height of the geoid above the ellipsoid, subtracted from EXIF altitudes that are ellipsoidal
    (H = h - N); 0 for those above sea level.
    """

    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    height_above_ground: float = 2.0
    geoid_undulation: float = 0.0
    sensor_width_mm: float | None = None


@dataclass(frozen=True, eq=False)
class PlacedPhoto:
    """A photo with all that the graph needs. `notes`: what had to be assumed, for the user."""

    photo: Photo
    camera: Camera
    pose: Pose
    stamp_ns: int
    notes: list[str] = field(default_factory=list)


def place(photo: Photo, row: PhotoPose, frame: SiteFrame, dem: Dem | None, assumed: Assumptions) -> PlacedPhoto:
    """Join what is known of a photo.

    `dem`: in the map frame; without one, a camera's height must be known. Raises PoseError, CameraError or
    RecordingError where position, azimuth, focal length or date are known from nowhere, with the remedy.
    """
    notes: list[str] = []
    stamp_ns, taken = _stamp(photo, row, notes)
    x, y = _position(photo, row, frame)
    z = _height(photo, row, x, y, dem, assumed, notes)
    azimuth = _azimuth_deg(photo, row, frame, (x, y, z), taken, notes)
    pitch = row.pitch_deg if row.pitch_deg is not None else assumed.pitch_deg
    roll = row.roll_deg if row.roll_deg is not None else assumed.roll_deg
    if row.pitch_deg is None:
        notes.append(f"pitch is not known (EXIF has none): taken as {pitch:g} deg")
    if photo.turned:
        notes.append(
            f"{photo.turned}: taken upright, as {photo.width} x {photo.height} pixels, of which calibration, pitch and "
            "roll must be"
        )
    pose = Pose.from_angles((x, y, z), azimuth, pitch, roll)
    return PlacedPhoto(photo, _camera(photo, row, assumed), pose, stamp_ns, notes)


def _stamp(photo: Photo, row: PhotoPose, notes: list[str]) -> tuple[int, datetime]:
    taken = row.stamp or photo.exif.taken
    if taken is None:
        raise RecordingError(f"{photo.path} has no date: give it a `stamp` (ISO 8601) in the pose file")
    if taken.tzinfo is None:
        if row.stamp is None:
            notes.append(f"EXIF date {taken.isoformat()} has no time zone: taken as UTC")
        taken = taken.replace(tzinfo=UTC)
    since = taken - datetime(1970, 1, 1, tzinfo=UTC)
    if since.days < 0:
        raise RecordingError(
            f"{photo.path} is dated {taken.isoformat()}, before 1970: give it a `stamp` in the pose file"
        )
    return (since.days * 86_400 + since.seconds) * _NS_PER_S + since.microseconds * 1000, taken


def _position(photo: Photo, row: PhotoPose, frame: SiteFrame) -> tuple[float, float]:
    if row.x is not None and row.y is not None:
        return row.x - frame.x_origin, row.y - frame.y_origin
    lon, lat = (row.lon, row.lat) if row.lon is not None else (photo.exif.lon, photo.exif.lat)
    if lon is None or lat is None:
        raise PoseError(f"{photo.path} has no position in EXIF: give it x, y or lon, lat in a pose file (--poses)")
    x, y = frame.from_lonlat(lon, lat)
    if not (math.isfinite(x) and math.isfinite(y)):
        raise PoseError(f"{photo.path}: position lon {lon}, lat {lat} lies outside the site's CRS {frame.crs}")
    return float(x), float(y)


def _height(
    photo: Photo, row: PhotoPose, x: float, y: float, dem: Dem | None, assumed: Assumptions, notes: list[str]
) -> float:
    ground = float(dem.elevation_at(x, y)) if dem is not None else math.nan
    if row.z is not None:
        return _stated_height(photo, row.z, ground, notes)
    altitude = photo.exif.altitude
    if row.height_above_ground is None and altitude is not None:
        z = altitude - assumed.geoid_undulation
        if not z < ground:  # also where the ground is not known
            if z > ground + _SUSPECT_HEIGHT:
                notes.append(f"EXIF altitude {z:.1f} m is {z - ground:.1f} m above the terrain: {_MAYBE_ELLIPSOIDAL}")
            return z
        notes.append(
            f"EXIF altitude {z:.1f} m is {ground - z:.1f} m under the terrain: taken as "
            f"{assumed.height_above_ground:g} m above it; {_MAYBE_ELLIPSOIDAL}"
        )
    above = row.height_above_ground
    if above is None:
        above = assumed.height_above_ground
        if altitude is None:
            notes.append(f"height is not known: taken as {above:g} m above the terrain")
    if math.isnan(ground):
        why = "there is no DEM (give --site)" if dem is None else "it stands outside the DEM"
        raise PoseError(f"{photo.path} at map ({x:.1f}, {y:.1f}): height above ground does not help, {why}; give its z")
    return ground + above


def _stated_height(photo: Photo, z: float, ground: float, notes: list[str]) -> float:
    doubt = doubt_of_height(z, ground)
    if z <= ground:
        raise PoseError(f"{photo.path}: {doubt}")
    if doubt is not None:
        notes.append(doubt)
    return z


def _azimuth_deg(
    photo: Photo,
    row: PhotoPose,
    frame: SiteFrame,
    position: tuple[float, float, float],
    taken: datetime,
    notes: list[str],
) -> float:
    x, y, z = position
    if row.azimuth_deg is not None:
        azimuth, reference = row.azimuth_deg, row.azimuth_ref
    elif photo.exif.direction_deg is not None:
        azimuth = photo.exif.direction_deg
        reference = "magnetic" if photo.exif.direction_ref == "M" else "true"
        if photo.exif.direction_ref is None:
            notes.append(f"EXIF direction {azimuth:.1f} deg does not say from which north: taken as true north")
    else:
        raise PoseError(f"{photo.path} has no direction in EXIF: give it azimuth_deg in a pose file (--poses)")
    if reference == "magnetic":
        return frame.magnetic_to_grid_deg(azimuth, x, y, taken.date(), z)
    return frame.true_to_grid_deg(azimuth, x, y) if reference == "true" else azimuth


def _camera(photo: Photo, row: PhotoPose, assumed: Assumptions) -> Camera:
    width, height = photo.width, photo.height
    if row.fx is not None:
        fx = row.fx
    elif row.hfov_deg is not None:
        fx = Camera.from_fov(width, height, row.hfov_deg).fx
    else:
        from_exif = photo.exif.focal_px(width, height, assumed.sensor_width_mm)
        if from_exif is None:
            remedy = "give fx or hfov_deg in a pose file (--poses)"
            if photo.exif.focal_mm is not None:
                remedy += f" or, as EXIF has a focal length of {photo.exif.focal_mm:g} mm, --sensor-width-mm"
            raise CameraError(f"{photo.path}: EXIF does not tell the focal length in pixels: {remedy}")
        fx = from_exif
    cx = row.cx if row.cx is not None else (width - 1) / 2
    cy = row.cy if row.cy is not None else (height - 1) / 2
    if photo.turned and not (0 <= cx < width and 0 <= cy < height):  # of a part of a picture it may lie beside it
        raise CameraError(
            f"{photo.path}: principal point cx, cy = ({cx:g}, {cy:g}) lies beside the image of {width} x {height} "
            f"pixels, as {photo.turned}: give that of the upright image"
        )
    return Camera(
        width,
        height,
        fx,
        row.fy if row.fy is not None else fx,
        cx,
        cy,
        (row.k1, row.k2, row.p1, row.p2, row.k3),
    )
