"""Place one photo: camera, pose and stamp from its row in the pose file, the site's fixed camera and its sensors."""

import math
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np

from ltm_core.base.errors import CameraError, PoseError, RecordingError
from ltm_core.base.number_text import stamp_of_moment
from ltm_core.base.types import Float64Array
from ltm_core.cameras.camera_config import PartialCalibration, PartialPose
from ltm_core.cameras.plausibility import doubt_of_height
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import UNKNOWN_AZIMUTH_SIGMA_DEG, UNKNOWN_PITCH_SIGMA_DEG, Pose
from ltm_core.site.sections import CameraConfig
from ltm_ros.recordings.importing.assumptions import Assumptions, Surroundings, photo_time
from ltm_ros.recordings.importing.intrinsics import intrinsics
from ltm_ros.recordings.importing.photo import Photo, PhotoPose

_GPS_SIGMA, _ALTITUDE_SIGMA, _GROUND_SIGMA, _CLIMB_SIGMA = 5.0, 10.0, 1.0, 1.0
"""Standard deviations in metres: of positions and altitudes that state none, of heights above the terrain, and of
barometric heights above the start."""
_COMPASS_SIGMA_DEG, _TILT_SIGMA_DEG, _ATTITUDE_SIGMA_DEG = 8.2, 3.0, 1.0
"""Standard deviations in degrees: of directions that state none (a median error of 5.5), of an assumed pitch or roll,
and of one from sensors."""
_SUSPECT_HEIGHT = 25.0
_MAYBE_ELLIPSOIDAL = "if all photos have the same error, their altitudes are ellipsoidal: give --geoid-undulation-m"
_NOT_PLACED = "so that it places nothing until a pose is found (ltm pose photo)"


@dataclass(frozen=True, eq=False)
class PlacedPhoto:
    """A photo with all that the graph needs. `covariance`: (6, 6), None: the site's default. `notes`: for the user."""

    photo: Photo
    camera: Camera
    pose: Pose
    covariance: Float64Array | None
    stamp_ns: int
    notes: list[str] = field(default_factory=list)


def place(photo: Photo, row: PhotoPose, camera: str, site: Surroundings, assumed: Assumptions) -> PlacedPhoto:
    """Combine what is known of a photo: its row precedes the site's `camera`, which precedes sensors and EXIF.

    Raises PoseError, CameraError or RecordingError if position, azimuth, pitch, focal length or date are unknown."""
    fixed = site.cameras.get(camera, CameraConfig())
    known = row.pose
    if (whole := fixed.pose) is not None:  # pitch and roll that a site file omits are 0
        level = {"pitch_deg": whole.pitch_deg or 0.0, "roll_deg": whole.roll_deg or 0.0}
        known = known.over(whole.model_copy(update=level))
    placing = _Placing(photo, known, site, assumed)
    taken = photo_time(photo, row.stamp, assumed.time_zone, placing.notes)
    stamp_ns = stamp_of_moment(taken)
    if stamp_ns < 0:
        raise RecordingError(f"{photo.path} is dated {taken.isoformat()}, before 1970: give a `stamp` (--poses)")
    x, y = placing.position()
    place = x, y, placing.height(x, y)
    pose = Pose.from_angles(place, placing.azimuth_deg(place, taken), *placing.tilt())
    if photo.turned:
        size = f"{photo.width} x {photo.height} pixels"
        placing.notes.append(f"{photo.turned}: calibration, pitch and roll must be for the upright image of {size}")
    stated = known.model_dump(include=set(placing.found), exclude_none=True)
    error = site.pose_error
    covariance = known.model_copy(update=placing.found | stated).covariance(pose, error.position, error.angle_deg)
    return PlacedPhoto(photo, _camera(photo, row, fixed, assumed), pose, covariance, stamp_ns, placing.notes)


class _Placing:
    """Finds the parts of a photo's pose, from what is `known` to what is assumed. `notes`: assumptions, for the user.
    `found`: standard deviations of parts from sensors, by their keys. Raises PoseError throughout."""

    def __init__(self, photo: Photo, known: PartialPose, site: Surroundings, assumed: Assumptions) -> None:
        self.photo, self.sensed, self.known, self.site, self.assumed = photo, photo.sensed, known, site, assumed
        self.notes: list[str] = []
        self.found: dict[str, float] = {}

    def position(self) -> tuple[float, float]:
        """Return x, y in the map frame."""
        frame, sensed, stated = self.site.frame, self.sensed, self.known.xy(self.site.frame)
        if stated is not None:
            if not self.site.covers(*stated):
                east, north = stated[0] + frame.x_origin, stated[1] + frame.y_origin
                place = f"({east:.1f}, {north:.1f}) in {frame.crs}"
                raise PoseError(
                    f"{self.photo.path}: {place} is outside the DEM: check the order of coordinates and the CRS"
                )
            return stated
        lon, lat = sensed.lon, sensed.lat
        if lon is None or lat is None:
            why = f": {sensed.missing}" if sensed.missing else ""
            what = f"{self.photo.path} has no position in {sensed.source}{why}"
            raise PoseError(f"{what}; give it x, y or lon, lat in a pose file (--poses)")
        self.found["position_sigma"] = sensed.position_sigma or _GPS_SIGMA
        x, y = (float(value) for value in frame.from_lonlat(lon, lat))
        if not (math.isfinite(x) and math.isfinite(y)):
            raise PoseError(f"{self.photo.path}: position lon {lon}, lat {lat} lies outside the site's CRS {frame.crs}")
        if not self.site.covers(x, y):
            what = f"{self.photo.path}: position lon {lon:.6f}, lat {lat:.6f} in {sensed.source} is outside the DEM"
            raise PoseError(f"{what}: give another --site, or the right position in a pose file (--poses)")
        return x, y

    def height(self, x: float, y: float) -> float:
        """Return z in the map frame. Raises PoseError below the ground, and without a height."""
        dem, above, path = self.site.dem, self.known.height_above_ground, self.photo.path
        ground = float(dem.elevation_at(x, y)) if dem is not None else math.nan
        if (stated := self.known.z) is not None:
            doubt = doubt_of_height(stated, ground)
            if stated <= ground:
                raise PoseError(f"{path}: {doubt}")
            self.notes += [] if doubt is None else [doubt]
            return stated
        if above is None:
            sensed = self._climbed() or self._altitude(ground)
            why = "its altitude is not known"
            if sensed is not None:
                z, sigma, what = sensed
                if not z < ground:  # also if the ground is unknown
                    self.found["height_sigma"] = sigma
                    return z
                why = f"{what} {z:.1f} m is {ground - z:.1f} m under the terrain"
            self._refuse_in_flight(why)
            above, self.found["height_sigma"] = self.assumed.height_above_ground, _GROUND_SIGMA
            if sensed is not None:
                self.notes.append(f"{why}: {above:g} m above the terrain is assumed; {_MAYBE_ELLIPSOIDAL}")
            if self.sensed.altitude is None:
                self.notes.append(f"height is unknown: {above:g} m above the terrain is assumed")
        if math.isnan(ground):
            why = "there is no DEM (give --site)" if dem is None else "it is outside the DEM"
            raise PoseError(f"{path}: no height above ground at map ({x:.1f}, {y:.1f}), {why}; give its z (--poses)")
        return ground + above

    def _refuse_in_flight(self, why: str) -> None:
        """Raise PoseError for a drone of unknown height: it is not at eye height above the terrain."""
        sensed, path = self.sensed, self.photo.path
        if not sensed.in_flight or (sensed.climb is not None and self.assumed.start_height is not None):
            return
        if sensed.climb is None:
            raise PoseError(f"{path}: {why}: give the drone's z or height_above_ground in a pose file (--poses)")
        only = f"{sensed.source} only gives {sensed.climb:.1f} m above the take-off place"
        remedy = "its height in the DEM's vertical datum, --start-height (0 if the drone counts from sea level)"
        raise PoseError(f"{path}: {why}, and {only}: give {remedy}")

    def _altitude(self, ground: float) -> tuple[float, float, str] | None:
        """Return the height in the DEM's datum from an altitude, its standard deviation and its name; None without."""
        sensed, undulation = self.sensed, self.assumed.geoid_undulation
        if sensed.altitude is None:
            return None
        if sensed.ellipsoidal and undulation is None:
            above = f"{self.assumed.height_above_ground:g} m above the terrain is assumed"
            what = f"{sensed.source}'s altitudes are above the WGS 84 ellipsoid"
            self.notes.append(f"{what}: {above}; give --geoid-undulation-m to use them")
            return None
        z = sensed.altitude - (0.0 if sensed.ellipsoidal is False else undulation or 0.0)
        what = f"{sensed.source} altitude"
        if z > ground + _SUSPECT_HEIGHT:
            self.notes.append(f"{what} {z:.1f} m is {z - ground:.1f} m above the terrain: {_MAYBE_ELLIPSOIDAL}")
        return z, sensed.altitude_sigma or _ALTITUDE_SIGMA, what

    def _climbed(self) -> tuple[float, float, str] | None:
        """Return the height from the barometer, whose climb since the start is used, because of the weather.

        The start height is given, or the median that puts the whole walk at eye height above the terrain."""
        sensed, site, assumed = self.sensed, self.site, self.assumed
        if sensed.climb is None:
            return None
        what = f"{sensed.source} barometer's height"
        if assumed.start_height is not None:
            return assumed.start_height + sensed.climb, _CLIMB_SIGMA, what
        if sensed.walk is None or site.dem is None:
            return None
        lon, lat, climb = sensed.walk.T
        ground = site.dem.elevation_at(*site.frame.from_lonlat(lon, lat))
        starts = (ground - climb)[np.isfinite(ground)]
        if not len(starts):
            return None
        start = float(np.median(starts)) + assumed.height_above_ground
        return start + sensed.climb, math.hypot(_GROUND_SIGMA, _CLIMB_SIGMA), what

    def azimuth_deg(self, place: tuple[float, float, float], taken: datetime) -> float:
        """Return the azimuth from grid north."""
        frame, sensed = self.site.frame, self.sensed
        stated = self.known.grid_azimuth_deg(frame, place, taken.date())
        if stated is not None:
            return stated
        x, y, z = place
        azimuth = sensed.azimuth_deg
        if azimuth is None and self.assumed.keep_unknown:
            self.found["azimuth_sigma_deg"] = UNKNOWN_AZIMUTH_SIGMA_DEG
            self.notes.append(f"direction is unknown (0 +- {UNKNOWN_AZIMUTH_SIGMA_DEG:.0f} deg), {_NOT_PLACED}")
            return 0.0
        if azimuth is None:
            what = f"{self.photo.path} has no direction in {sensed.source}"
            raise PoseError(f"{what}: give azimuth_deg in a pose file (--poses), or --refine")
        self.found["azimuth_sigma_deg"] = _COMPASS_SIGMA_DEG
        if sensed.azimuth_ref == "M":
            return frame.magnetic_to_grid_deg(azimuth, x, y, taken.date(), z)
        if sensed.azimuth_ref is None:
            what = f"{sensed.source} direction {azimuth:.1f} deg"
            self.notes.append(f"{what} does not state its north reference: true north is assumed")
        return frame.true_to_grid_deg(azimuth, x, y)

    def tilt(self) -> tuple[float, float]:
        """Return pitch and roll in degrees."""
        sensed, assumed = self.sensed, self.assumed
        sigma, source = sensed.tilt_sigma_deg or _ATTITUDE_SIGMA_DEG, sensed.source
        pitch, roll = self.known.pitch_deg, self.known.roll_deg
        if pitch is None and sensed.pitch_deg is not None:
            pitch, self.found["pitch_sigma_deg"] = sensed.pitch_deg, sigma
        if roll is None and sensed.roll_deg is not None:
            roll, self.found["roll_sigma_deg"] = sensed.roll_deg, sigma
        if pitch is None and assumed.pitch_deg is not None:
            pitch, self.found["pitch_sigma_deg"] = assumed.pitch_deg, _TILT_SIGMA_DEG
            self.notes.append(f"pitch is unknown ({source} has none): {pitch:g} +- {_TILT_SIGMA_DEG:g} deg is assumed")
        if pitch is None and assumed.keep_unknown:
            pitch, self.found["pitch_sigma_deg"] = 0.0, UNKNOWN_PITCH_SIGMA_DEG
            self.notes.append(f"pitch is unknown (0 +- {UNKNOWN_PITCH_SIGMA_DEG:.0f} deg), {_NOT_PLACED}")
        if pitch is None:
            what = f"{self.photo.path}: its pitch is unknown ({source} has none)"
            raise PoseError(f"{what}: give pitch_deg in a pose file (--poses), --pitch-deg for all, or --refine")
        if roll is None:
            roll, self.found["roll_sigma_deg"] = 0.0, _TILT_SIGMA_DEG
            self.notes.append(f"roll is unknown: 0 +- {_TILT_SIGMA_DEG:g} deg is assumed")
        return pitch, roll


def _camera(photo: Photo, row: PhotoPose, fixed: CameraConfig, assumed: Assumptions) -> Camera:
    """Return the camera model. Raises CameraError as `intrinsics`, or if the row's calibration has another size."""
    width, height = photo.width, photo.height
    stated: PartialCalibration = row.calibration
    if stated.width is not None and (stated.width, stated.height) != (width, height):
        size = f"{stated.width} x {stated.height}"
        what = f"{photo.path} has {width} x {height} pixels upright, but the pose file's calibration {size}"
        raise CameraError(f"{what}: give fx or hfov_deg for this image size")
    if stated == PartialCalibration() and fixed.calibration is not None:
        stated = fixed.calibration
    cx, cy = stated.cx or 0.0, stated.cy or 0.0
    if photo.turned and not (0 <= cx < width and 0 <= cy < height):  # for a cropped image, it may be outside
        what = f"{photo.path}: cx, cy = ({cx:g}, {cy:g}) is outside the image of {width} x {height} pixels"
        raise CameraError(f"{what}, as {photo.turned}: give those of the upright image")
    if stated.fx is not None or stated.hfov_deg is not None:
        return stated.camera_of(width, height, 0.0)
    read = intrinsics(photo.lens, width, height, str(photo.path), assumed.focal_35mm)
    return (read if stated == PartialCalibration() else stated).camera_of(width, height, read.fx or 0.0)
