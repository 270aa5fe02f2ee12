"""Pose and calibration of a camera: one set of keys for site files, pose files and CSV columns.

A *partial* model holds what is known of a photo, the other what a camera needs."""

from datetime import date
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator
from pyproj import Transformer

from ltm_core.base.errors import ConfigError, PoseError
from ltm_core.base.strict_model import StrictModel, Written
from ltm_core.base.types import Float64Array
from ltm_core.cameras.plausibility import AzimuthDeg, PitchDeg, RollDeg, doubt_of_height
from ltm_core.geometry.camera import MOST_A_SIDE, Camera
from ltm_core.geometry.geodesy import SiteFrame, same_crs
from ltm_core.geometry.pose import Pose, pose_covariance
from ltm_core.raster.dem import Dem


class PartialCalibration(StrictModel):
    """Known part of a camera's calibration, in pixels of the upright image."""

    width: int | None = Field(None, gt=0)
    """Width of the image in pixels."""
    height: int | None = Field(None, gt=0)
    """Height of the image in pixels."""
    hfov_deg: float | None = Field(None, gt=0, lt=180)
    """Horizontal field of view in degrees between the image's outer edges; instead of fx."""
    fx: Written[float | None] = Field(None, gt=0)
    """Horizontal focal length in pixels."""
    fy: Written[float | None] = Field(None, gt=0)
    """Vertical focal length in pixels; default: fx."""
    cx: Written[float | None] = None
    """Column of the principal point in pixels; default: the image's centre."""
    cy: Written[float | None] = None
    """Row of the principal point in pixels; default: the image's centre."""
    k1: Written[float] = 0.0
    """First radial distortion after Brown and Conrady (plumb_bob of CameraInfo)."""
    k2: Written[float] = 0.0
    """Second radial distortion."""
    p1: Written[float] = 0.0
    """First tangential distortion."""
    p2: Written[float] = 0.0
    """Second tangential distortion."""
    k3: Written[float] = 0.0
    """Third radial distortion."""

    @model_validator(mode="after")
    def _no_contradiction(self) -> Self:
        if self.hfov_deg is not None and self.fx is not None:
            raise ValueError("give either hfov_deg or fx, not both")
        if self.fy is not None and self.fx is None:
            raise ValueError("fy needs fx")
        if (self.width is None) != (self.height is None):
            raise ValueError("give both width and height, or neither")
        return self

    def camera_of(self, width: int, height: int, fx: float) -> Camera:
        """Return the camera of an image of this size; `fx` applies if neither fx nor hfov_deg is stated."""
        if self.hfov_deg is not None:
            fx = Camera.from_fov(width, height, self.hfov_deg).fx
        fx = fx if self.fx is None else self.fx
        fy = fx if self.fy is None else self.fy
        cx = (width - 1) / 2 if self.cx is None else self.cx
        cy = (height - 1) / 2 if self.cy is None else self.cy
        return Camera(width, height, fx, fy, cx, cy, (self.k1, self.k2, self.p1, self.p2, self.k3))


class CalibrationConfig(PartialCalibration):
    """Complete calibration: the image's size, and either `hfov_deg` or fx (and fy, cx, cy if known)."""

    width: int = Field(gt=0, le=MOST_A_SIDE)
    height: int = Field(gt=0, le=MOST_A_SIDE)

    @model_validator(mode="after")
    def _one_focal_length(self) -> Self:
        if self.hfov_deg is None and self.fx is None:
            raise ValueError("give either hfov_deg or fx")
        return self

    def camera(self) -> Camera:
        return self.camera_of(self.width, self.height, self.fx or 0.0)


def _unquoted(value: object) -> object:
    return "true" if value is True else value  # YAML reads the bare word as a boolean


_PARTS = (
    (("x", "y", "crs", "lon", "lat"), ("position_sigma",)),
    (("z", "height_above_ground"), ("height_sigma",)),
    (("azimuth_deg",), ("azimuth_sigma_deg",)),
    (("pitch_deg",), ("pitch_sigma_deg",)),
    (("roll_deg",), ("roll_sigma_deg",)),
)
"""Keys of a pose that are given together, and those of their standard deviations."""


class PartialPose(StrictModel):
    """Known part of a camera's pose. Angles in degrees, lengths in metres, sigmas are standard deviations."""

    x: float | None = None
    """Easting in `crs`, in metres, without subtracting an origin."""
    y: float | None = None
    """Northing in `crs`, in metres."""
    crs: Written[str | None] = None
    """CRS of x and y; default: that of the site or of the DEM. In EPSG:4326, x and y are longitude and latitude."""
    lon: float | None = Field(None, ge=-180, le=180)
    """Longitude in WGS 84 degrees, instead of x."""
    lat: float | None = Field(None, ge=-90, le=90)
    """Latitude in WGS 84 degrees, instead of y."""
    z: float | None = None
    """Height in metres in the DEM's vertical datum."""
    height_above_ground: float | None = Field(None, ge=0)
    """Height in metres above the DEM (mast, tripod), instead of z."""
    azimuth_deg: AzimuthDeg | None = None
    """Azimuth of the optical axis in degrees, clockwise from the north that `azimuth_ref` names."""
    azimuth_ref: Annotated[Literal["grid", "true", "magnetic"], BeforeValidator(_unquoted)] = "grid"
    """North that `azimuth_deg` is measured from."""
    pitch_deg: PitchDeg | None = None
    """Pitch in degrees, up from the horizon."""
    roll_deg: RollDeg | None = None
    """Roll in degrees, clockwise about the viewing direction."""
    position_sigma: Written[float | None] = Field(None, gt=0)
    """Standard deviation of x and of y in metres."""
    height_sigma: Written[float | None] = Field(None, gt=0)
    """Standard deviation of the height in metres."""
    azimuth_sigma_deg: Written[float | None] = Field(None, gt=0)
    """Standard deviation of the azimuth in degrees."""
    pitch_sigma_deg: Written[float | None] = Field(None, gt=0)
    """Standard deviation of the pitch in degrees."""
    roll_sigma_deg: Written[float | None] = Field(None, gt=0)
    """Standard deviation of the roll in degrees."""

    @model_validator(mode="after")
    def _no_contradiction(self) -> Self:
        for a, b in (("x", "y"), ("lon", "lat")):
            if (getattr(self, a) is None) != (getattr(self, b) is None):
                raise ValueError(f"give both {a} and {b}, or neither")
        for a, b in (("x", "lon"), ("z", "height_above_ground"), ("lon", "crs")):
            if getattr(self, a) is not None and getattr(self, b) is not None:
                raise ValueError(f"give either {a} or {b}, not both")
        return self

    def over(self, other: "PartialPose | None") -> "PartialPose":
        """Return this pose, completed (place, height, azimuth, pitch, roll, each with its sigma) from another one."""
        if other is None:
            return self
        taken: dict[str, Any] = {}
        for keys, sigmas in _PARTS:
            if all(getattr(self, key) is None for key in keys):
                taken |= {key: getattr(other, key) for key in keys}
                taken |= {key: getattr(other, key) for key in sigmas if getattr(self, key) is None}
                if "azimuth_deg" in keys:
                    taken["azimuth_ref"] = other.azimuth_ref
        return PartialPose.model_validate(self.model_dump() | taken)

    def covariance(self, pose: Pose, position: float, angle_deg: float) -> Float64Array | None:
        """Return the (6, 6) covariance as in `pose_covariance` from the stated sigmas; None if there are none.

        `pose`: this one, in the map frame. `position`, `angle_deg`: sigmas where some are stated and others not."""
        degrees = (self.azimuth_sigma_deg, self.pitch_sigma_deg, self.roll_sigma_deg)
        stated = (self.position_sigma, self.height_sigma, *degrees)
        if all(sigma is None for sigma in stated):
            return None
        usual = (position, position, angle_deg, angle_deg, angle_deg)
        return pose_covariance(pose, *(u if sigma is None else sigma for sigma, u in zip(stated, usual, strict=True)))

    def sigmas_of_place(self) -> tuple[float, float, float] | None:
        """Return the standard deviations of x, y and height in metres; None if none is stated."""
        plan = self.position_sigma or self.height_sigma
        height = self.height_sigma or self.position_sigma
        return None if plan is None or height is None else (plan, plan, height)

    def xy(self, frame: SiteFrame) -> tuple[float, float] | None:
        """Return the position in the map frame; None if it is not known.

        Raises ConfigError for a CRS that is none, PoseError for a place that has none in the frame's."""
        stated = self._stated()
        if stated is None:
            return None
        x, y, crs = stated
        x, y = _transformed(x, y, crs or frame.crs, frame.crs)
        return x - frame.x_origin, y - frame.y_origin

    def _stated(self) -> tuple[float, float, str | None] | None:
        """Return the position as stated, and its CRS if it is stated."""
        if self.lon is not None and self.lat is not None:
            return self.lon, self.lat, "EPSG:4326"
        return None if self.x is None or self.y is None else (self.x, self.y, self.crs)

    def lonlat(self) -> tuple[float, float] | tuple[None, None]:
        """Return the position in WGS 84 degrees; None if it is not known without a frame. Raises as `xy` does."""
        x, y, crs = self._stated() or (0.0, 0.0, None)
        return (None, None) if crs is None else _transformed(x, y, crs, "EPSG:4326")

    def grid_azimuth_deg(self, frame: SiteFrame, place: tuple[float, float, float], on: date | None) -> float | None:
        """Return the azimuth from grid north at a map place. Raises ConfigError for a magnetic one without a date."""
        azimuth = self.azimuth_deg
        if azimuth is None or self.azimuth_ref == "grid":
            return azimuth
        x, y, z = place
        if self.azimuth_ref == "true":
            return frame.true_to_grid_deg(azimuth, x, y)
        if on is None:
            what = f"azimuth_deg {azimuth:g} is magnetic, and the day of the reading is not known"
            raise ConfigError(f"{what}: give it from true north (azimuth_ref: true) or from grid north")
        return frame.magnetic_to_grid_deg(azimuth, x, y, on, z)


class PlacedPose(PartialPose):
    """Pose with a known place: x, y or lon, lat, and z or `height_above_ground`."""

    @model_validator(mode="after")
    def _a_place(self) -> Self:
        if self.x is None and self.lon is None:
            raise ValueError("give x and y, or lon and lat")
        if self.z is None and self.height_above_ground is None:
            raise ValueError("give either z or height_above_ground")
        return self

    def described(self, frame: SiteFrame) -> str:
        """Return the place as stated, with its coordinates in the frame's CRS if these differ. Raises as `xy`."""
        x, y, crs = self._stated() or (0.0, 0.0, None)
        given = f"({x:.10g}, {y:.10g})"
        if crs is None or same_crs(crs, frame.crs):
            return given
        x, y = self.xy(frame) or (0.0, 0.0)
        return f"{given} in {crs}, that is ({x + frame.x_origin:.0f}, {y + frame.y_origin:.0f}) in {frame.crs}"

    def position(self, dem: Dem, frame: SiteFrame) -> tuple[float, float, float]:
        """Return the position in the map frame. Raises PoseError if the ground is needed and not known."""
        place = self.xy(frame)
        assert place is not None  # nosec B101 # tells the type checker what holds
        if self.z is not None:
            return *place, self.z
        ground = float(dem.elevation_at(*place))
        if ground != ground:
            covered = dem.levels[-1].geometry.translated(frame.x_origin, frame.y_origin)
            raise PoseError(
                f"no terrain under the camera at {self.described(frame)}: give its z instead of height_above_ground, "
                f"or check position and crs; the DEM covers {covered.described()} in {frame.crs}"
            )
        return *place, ground + (self.height_above_ground or 0.0)


class PoseConfig(PlacedPose):
    """Complete pose. Pitch and roll are 0 unless given."""

    azimuth_deg: AzimuthDeg

    def pose(self, dem: Dem, frame: SiteFrame) -> Pose:
        """Return the pose in the map frame. Raises PoseError, also for a camera under the ground, and ConfigError."""
        place = self.position(dem, frame)
        ground = float(dem.elevation_at(*place[:2]))
        if place[2] <= ground:
            raise PoseError(f"camera at {self.described(frame)}: {doubt_of_height(place[2], ground)}")
        azimuth = self.grid_azimuth_deg(frame, place, None)
        assert azimuth is not None  # nosec B101 # tells the type checker what holds
        return Pose.from_angles(place, azimuth, self.pitch_deg or 0.0, self.roll_deg or 0.0)


def _transformed(x: float, y: float, source: str, target: str) -> tuple[float, float]:
    if same_crs(source, target):
        return x, y
    moved = Transformer.from_crs(source, target, always_xy=True).transform(x, y)
    if not np.isfinite(moved).all():
        what = f"position ({x}, {y}) in {source} cannot be converted to {target}"
        raise PoseError(f"{what}; with EPSG:4326 give longitude first")
    return float(moved[0]), float(moved[1])
