"""What photos are placed by beside what they say themselves: the site around them, and what the user lets us assume."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import tzinfo

from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.raster.dem import Dem
from ltm_core.site.sections import CameraConfig
from ltm_core.surface.config import PoseErrorConfig


@dataclass(frozen=True)
class Assumptions:
    """What to take where neither pose file, site nor sensors say it. Angles in degrees, lengths in metres.

    `pitch_deg`: None: a photo of unknown pitch is refused, since a wrong one moves all that it sees; so is one of
    unknown azimuth. `keep_unknown`: neither is refused, but taken with the covariance of an angle of which nothing is
    known, so that nothing is placed by it until the angle is found. `geoid_undulation`: height of the geoid above the
    ellipsoid, subtracted from altitudes that are ellipsoidal (H = h - N); where it is given, EXIF's are taken to be so.
    `start_height`: of the camera where a barometer's record begins, in the DEM's vertical datum. `focal_35mm`: focal
    length as of a 36 mm wide film. `every`: seconds from one frame of a video to the next. Sigmas: `gps_sigma` where a
    position states none, `altitude_sigma` of altitudes that state none, `ground_sigma` of heights above the terrain,
    `climb_sigma` of barometric heights above the start, `compass_sigma_deg` of directions that state none (5.5 degrees
    off in the median are 8.2 for a normal distribution), `tilt_sigma_deg` of an assumed pitch or roll,
    `attitude_sigma_deg` of one that sensors gave.
    """

    pitch_deg: float | None = None
    roll_deg: float = 0.0
    height_above_ground: float = 2.0
    geoid_undulation: float | None = None
    sensor_width_mm: float | None = None
    time_zone: tzinfo | None = None
    gps_sigma: float = 5.0
    altitude_sigma: float = 10.0
    ground_sigma: float = 1.0
    climb_sigma: float = 1.0
    compass_sigma_deg: float = 8.2
    tilt_sigma_deg: float = 3.0
    attitude_sigma_deg: float = 1.0
    keep_unknown: bool = False
    start_height: float | None = None
    focal_35mm: float | None = None
    every: float = 1.0


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Where photos are placed: the map frame, its DEM where there is one (else heights must be known), what is known of
    the cameras by name, and the error of poses that state none.
    """

    frame: SiteFrame
    dem: Dem | None = None
    cameras: Mapping[str, CameraConfig] = field(default_factory=dict)
    pose_error: PoseErrorConfig = field(default_factory=PoseErrorConfig)
