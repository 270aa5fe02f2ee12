"""Camera, pose and stamp of one photo, from its row in the pose file, the site's fixed camera and its EXIF."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, tzinfo

from ltm_core.camera import Camera
from ltm_core.camera_config import PartialCalibration, PartialPose, PoseConfig
from ltm_core.dem import Dem
from ltm_core.errors import CameraError, PoseError, RecordingError
from ltm_core.geodesy import SiteFrame
from ltm_core.plausibility import doubt_of_height
from ltm_core.pose import Pose
from ltm_core.site import CameraConfig, PoseErrorConfig
from ltm_core.types import Float64Array
from ltm_ros.importer.photo import Photo
from ltm_ros.importer.photo_time import photo_time
from ltm_ros.importer.pose_file import PhotoPose

_NS_PER_S = 1_000_000_000
_SUSPECT_HEIGHT = 25.0
_MAYBE_ELLIPSOIDAL = "if all photos are off alike, their altitudes are ellipsoidal: give --geoid-undulation-m"


@dataclass(frozen=True)
class Assumptions:
    """What to take where neither pose file, site nor EXIF says it. Angles in degrees, lengths in metres.

    `pitch_deg`: None: a photo of unknown pitch is refused, since a wrong one moves all that it sees.
    `geoid_undulation`: height of the geoid above the ellipsoid, subtracted from EXIF altitudes that are ellipsoidal
    (H = h - N); 0 for those above sea level. Sigmas: `gps_sigma` where EXIF states none, `altitude_sigma` of EXIF
    altitudes, `ground_sigma` of heights above the terrain, `compass_sigma_deg` of EXIF directions (5.5 degrees off in
    the median are 8.2 for a normal distribution), `tilt_sigma_deg` of an assumed pitch or roll.
    """

    pitch_deg: float | None = None
    roll_deg: float = 0.0
    height_above_ground: float = 2.0
    geoid_undulation: float = 0.0
    sensor_width_mm: float | None = None
    time_zone: tzinfo | None = None
    gps_sigma: float = 5.0
    altitude_sigma: float = 10.0
    ground_sigma: float = 1.0
    compass_sigma_deg: float = 8.2
    tilt_sigma_deg: float = 3.0


@dataclass(frozen=True, eq=False)
class PlacedPhoto:
    """A photo with all that the graph needs. `covariance`: (6, 6) of the pose; None: it is as good as the site assumes
    of poses. `notes`: what had to be assumed, for the user.
    """

    photo: Photo
    camera: Camera
    pose: Pose
    covariance: Float64Array | None
    stamp_ns: int
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Where photos are placed: the map frame, its DEM where there is one (else heights must be known), what is known of
    the cameras by name, and the error of poses that state none.
    """

    frame: SiteFrame
    dem: Dem | None = None
    cameras: Mapping[str, CameraConfig] = field(default_factory=dict)
    pose_error: PoseErrorConfig = field(default_factory=PoseErrorConfig)


def place(photo: Photo, row: PhotoPose, camera: str, site: Surroundings, assumed: Assumptions) -> PlacedPhoto:
    """Join what is known of a photo: its row goes before the site's fixed pose and calibration of `camera`, which go
    before EXIF.

    Raises PoseError, CameraError or RecordingError where position, azimuth, pitch, focal length or date are known from
    nowhere, with the remedy.
    """
    notes: list[str] = []
    taken = photo_time(photo, row.stamp, assumed.time_zone, notes)
    stamp_ns = _stamp_ns(photo, taken)
    fixed = site.cameras.get(camera, CameraConfig())
    known = row.pose.over(_whole(fixed.pose))
    found: dict[str, float] = {}
    x, y = _position(photo, known, site.frame, assumed, found)
    z = _height(photo, known, x, y, site.dem, assumed, notes, found)
    azimuth = _azimuth_deg(photo, known, site.frame, (x, y, z), taken, assumed, notes, found)
    pitch, roll = known.pitch_deg, known.roll_deg
    if pitch is None:
        pitch = assumed.pitch_deg
        if pitch is None:
            raise PoseError(
                f"{photo.path}: its pitch is not known (EXIF has none): give pitch_deg in a pose file (--poses), or "
                "--pitch-deg for all photos"
            )
        found["pitch_sigma_deg"] = assumed.tilt_sigma_deg
        notes.append(f"pitch is not known (EXIF has none): taken as {pitch:g} +- {assumed.tilt_sigma_deg:g} deg")
    if roll is None:
        roll, found["roll_sigma_deg"] = assumed.roll_deg, assumed.tilt_sigma_deg
        notes.append(f"roll is not known: taken as {roll:g} +- {assumed.tilt_sigma_deg:g} deg")
    if photo.turned:
        notes.append(
            f"{photo.turned}: taken upright, as {photo.width} x {photo.height} pixels, of which calibration, pitch and "
            "roll must be"
        )
    pose = Pose.from_angles((x, y, z), azimuth, pitch, roll)
    stated = known.model_dump(include=set(found), exclude_none=True)
    error = site.pose_error
    covariance = known.model_copy(update=found | stated).covariance(pose, error.position, error.angle_deg)
    return PlacedPhoto(photo, _camera(photo, row, fixed, assumed), pose, covariance, stamp_ns, notes)


def _whole(fixed: PoseConfig | None) -> PartialPose | None:
    """Pitch and roll that a site file leaves out are 0."""
    if fixed is None:
        return None
    return fixed.model_copy(update={"pitch_deg": fixed.pitch_deg or 0.0, "roll_deg": fixed.roll_deg or 0.0})


def _stamp_ns(photo: Photo, taken: datetime) -> int:
    since = taken - datetime(1970, 1, 1, tzinfo=UTC)
    if since.days < 0:
        raise RecordingError(
            f"{photo.path} is dated {taken.isoformat()}, before 1970: give it a `stamp` in the pose file"
        )
    return (since.days * 86_400 + since.seconds) * _NS_PER_S + since.microseconds * 1000


def _position(
    photo: Photo, known: PartialPose, frame: SiteFrame, assumed: Assumptions, found: dict[str, float]
) -> tuple[float, float]:
    stated = known.xy(frame)
    if stated is not None:
        return stated
    lon, lat = photo.exif.lon, photo.exif.lat
    if lon is None or lat is None:
        raise PoseError(f"{photo.path} has no position in EXIF: give it x, y or lon, lat in a pose file (--poses)")
    found["position_sigma"] = photo.exif.position_error or assumed.gps_sigma
    x, y = frame.from_lonlat(lon, lat)
    if not (math.isfinite(x) and math.isfinite(y)):
        raise PoseError(f"{photo.path}: position lon {lon}, lat {lat} lies outside the site's CRS {frame.crs}")
    return float(x), float(y)


def _height(
    photo: Photo,
    known: PartialPose,
    x: float,
    y: float,
    dem: Dem | None,
    assumed: Assumptions,
    notes: list[str],
    found: dict[str, float],
) -> float:
    ground = float(dem.elevation_at(x, y)) if dem is not None else math.nan
    if known.z is not None:
        return _stated_height(photo, known.z, ground, notes)
    altitude = photo.exif.altitude
    if known.height_above_ground is None and altitude is not None:
        z = altitude - assumed.geoid_undulation
        if not z < ground:  # also where the ground is not known
            if z > ground + _SUSPECT_HEIGHT:
                notes.append(f"EXIF altitude {z:.1f} m is {z - ground:.1f} m above the terrain: {_MAYBE_ELLIPSOIDAL}")
            found["height_sigma"] = assumed.altitude_sigma
            return z
        notes.append(
            f"EXIF altitude {z:.1f} m is {ground - z:.1f} m under the terrain: taken as "
            f"{assumed.height_above_ground:g} m above it; {_MAYBE_ELLIPSOIDAL}"
        )
    above = known.height_above_ground
    if above is None:
        above, found["height_sigma"] = assumed.height_above_ground, assumed.ground_sigma
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
    known: PartialPose,
    frame: SiteFrame,
    position: tuple[float, float, float],
    taken: datetime,
    assumed: Assumptions,
    notes: list[str],
    found: dict[str, float],
) -> float:
    stated = known.grid_azimuth_deg(frame, position, taken.date())
    if stated is not None:
        return stated
    x, y, z = position
    azimuth = photo.exif.direction_deg
    if azimuth is None:
        raise PoseError(f"{photo.path} has no direction in EXIF: give it azimuth_deg in a pose file (--poses)")
    found["azimuth_sigma_deg"] = assumed.compass_sigma_deg
    if photo.exif.direction_ref == "M":
        return frame.magnetic_to_grid_deg(azimuth, x, y, taken.date(), z)
    if photo.exif.direction_ref is None:
        notes.append(f"EXIF direction {azimuth:.1f} deg does not say from which north: taken as true north")
    return frame.true_to_grid_deg(azimuth, x, y)


def _camera(photo: Photo, row: PhotoPose, fixed: CameraConfig, assumed: Assumptions) -> Camera:
    """Raises CameraError where the focal length is known from nowhere, or the row's calibration is of another size."""
    width, height = photo.width, photo.height
    stated: PartialCalibration = row.calibration
    if stated.width is not None and (stated.width, stated.height) != (width, height):
        raise CameraError(
            f"{photo.path} has {width} x {height} pixels upright, but its calibration in the pose file is of "
            f"{stated.width} x {stated.height}: give fx or hfov_deg for this image size, or photos of that size"
        )
    if stated == PartialCalibration() and fixed.calibration is not None:
        stated = fixed.calibration
    cx, cy = stated.cx or 0.0, stated.cy or 0.0
    if photo.turned and not (0 <= cx < width and 0 <= cy < height):  # of a part of a picture it may lie beside it
        raise CameraError(
            f"{photo.path}: principal point cx, cy = ({cx:g}, {cy:g}) lies beside the image of {width} x {height} "
            f"pixels, as {photo.turned}: give that of the upright image"
        )
    if stated.fx is not None or stated.hfov_deg is not None:
        return stated.camera_of(width, height, 0.0)
    fx = photo.exif.focal_px(width, height, assumed.sensor_width_mm)
    if fx is None:
        remedy = "give fx or hfov_deg in a pose file (--poses)"
        if photo.exif.focal_mm is not None:
            remedy += f" or, as EXIF has a focal length of {photo.exif.focal_mm:g} mm, --sensor-width-mm"
        raise CameraError(f"{photo.path}: EXIF does not tell the focal length in pixels: {remedy}")
    return stated.camera_of(width, height, fx)
