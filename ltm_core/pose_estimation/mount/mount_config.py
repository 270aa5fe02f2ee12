"""The mount of a PTZ head in a site file, as written by `ltm pose mount`."""

import math
from typing import Any, Self

import numpy as np
from pydantic import Field, model_validator

from ltm_core.base.strict_model import Expert, StrictModel, Written
from ltm_core.cameras.camera_config import PoseConfig
from ltm_core.cameras.plausibility import PitchDeg
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import pose_covariance
from ltm_core.geometry.zoom_lens import LensConfig, ZoomLens
from ltm_core.pose_estimation.mount.mount_model import MountModel, Sign
from ltm_core.raster.dem import Dem


class MountConfig(PoseConfig):
    """Position and mounting of a PTZ head: the keys of a pose are those of its camera at pan and tilt 0. The sigmas'
    defaults are those of a PTZ head that was set up with a compass and a level, and never calibrated."""

    azimuth_sigma_deg: Written[float | None] = Field(1.5, gt=0)
    pitch_sigma_deg: Written[float | None] = Field(0.5, gt=0)
    roll_sigma_deg: Written[float | None] = Field(0.5, gt=0)
    position_sigma: Written[float | None] = Field(0.5, gt=0)
    height_sigma: Written[float | None] = Field(0.5, gt=0)
    tilt_zero_deg: Written[PitchDeg] = 0.0
    """Angle in degrees added to each tilt, positive upwards."""
    tilt_zero_sigma_deg: Written[float] = Field(0.3, gt=0)
    """Standard deviation of `tilt_zero_deg` in degrees."""
    pan_sign: Written[Sign] = 1
    """Sign of pan: 1 if pan grows clockwise as seen from above, else -1."""
    tilt_sign: Written[Sign] = 1
    """Sign of tilt: 1 if tilt grows upwards, else -1."""
    encoder_sigma_deg: Written[float] = Field(0.03, gt=0)
    """Standard deviation of pan and of tilt in degrees when the PTZ head returns to a reading."""
    covariance_deg2: Written[tuple[tuple[float, ...], ...] | None] = None
    """Calibrated covariance of azimuth, pitch, roll and tilt zero in squared degrees, 4 by 4, instead of sigmas."""
    lens: Written[LensConfig | None] = None
    """Zoom lens of the camera; None: the lens does not zoom, and `calibration` describes it."""

    @model_validator(mode="after")
    def _a_covariance(self) -> Self:
        if self.covariance_deg2 is None:
            return self
        if [len(row) for row in self.covariance_deg2] != [4] * 4:
            raise ValueError("covariance_deg2 must be 4 by 4: azimuth, pitch, roll, tilt zero")
        matrix = np.array(self.covariance_deg2)
        if not np.allclose(matrix, matrix.T, rtol=1e-4, atol=1e-12) or np.linalg.eigvalsh(matrix)[0] < -1e-9:
            raise ValueError("covariance_deg2 is not a covariance: it must be symmetric, without negative variances")
        return self

    @property
    def calibrated(self) -> bool:
        return self.covariance_deg2 is not None

    def model(self, dem: Dem, frame: SiteFrame) -> MountModel:
        """Return the mount in the map frame. Raises as `PoseConfig.pose`."""
        base = self.pose(dem, frame)
        sigmas = (self.position_sigma, self.height_sigma, *self.angle_sigmas_deg[:3])
        covariance = np.zeros((7, 7))
        covariance[:6, :6] = pose_covariance(base, *(sigma or 0.0 for sigma in sigmas))
        covariance[6, 6] = math.radians(self.tilt_zero_sigma_deg) ** 2
        tilt_zero, encoder = math.radians(self.tilt_zero_deg), math.radians(self.encoder_sigma_deg)
        model = MountModel(base, tilt_zero, covariance, self.pan_sign, self.tilt_sign, encoder)
        if self.covariance_deg2 is None:
            return model
        return model.with_angle_covariance(np.radians(np.radians(np.array(self.covariance_deg2, np.float64))))

    @property
    def angle_sigmas_deg(self) -> tuple[float, float, float, float]:
        """Return the stated sigmas of azimuth, pitch, roll and tilt zero."""
        level = self.pitch_sigma_deg or 0.5, self.roll_sigma_deg or 0.5
        return self.azimuth_sigma_deg or 1.5, *level, self.tilt_zero_sigma_deg


def written_mount(model: MountModel, lens: ZoomLens | None, frame: SiteFrame) -> dict[str, Any]:
    """Return the section `mount` of a calibrated PTZ head for YAML, with its position in the frame's CRS."""
    x, y, z = (float(v) for v in model.base.position)
    azimuth, pitch, roll = model.base.angles_deg
    metres = {"x": x + frame.x_origin, "y": y + frame.y_origin, "z": z}
    degrees = {"azimuth_deg": azimuth, "pitch_deg": pitch, "roll_deg": roll}
    degrees["tilt_zero_deg"] = math.degrees(model.tilt_zero)
    section: dict[str, Any] = {name: round(value, 3) for name, value in metres.items()}
    section |= {name: round(value, 4) for name, value in degrees.items()}
    section |= {"pan_sign": model.pan_sign, "tilt_sign": model.tilt_sign}
    section["encoder_sigma_deg"] = _short(math.degrees(model.encoder_sigma))
    place = np.sqrt(np.diag(model.covariance)[:3])
    sigmas = {"position_sigma": max(place[0], place[1]), "height_sigma": place[2]}
    section |= {key: _short(value) for key, value in sigmas.items() if value > 0}
    angles = np.degrees(np.degrees(model.angle_covariance))
    for name, variance in zip(("azimuth", "pitch", "roll", "tilt_zero"), np.diag(angles), strict=True):
        section[f"{name}_sigma_deg"] = _short(max(math.sqrt(variance), 1e-6))
    section["covariance_deg2"] = [[float(f"{value:.8g}") for value in row] for row in (angles + angles.T) / 2]
    if lens is not None:
        config = lens.config()
        zoom = [point.model_dump(exclude_defaults=True) for point in config.zoom]
        section["lens"] = config.model_dump(exclude={"zoom"}) | {"zoom": zoom}
    return section


def _short(value: float) -> float:
    return float(f"{value:.3g}")


class PoseRefinementConfig(StrictModel):
    """Settings for refining poses of mounted cameras by their images; a site with this section runs the node `pose` for
    each camera. Angles in degrees."""

    every: Expert[float] = Field(10.0, ge=0)
    """Minimum seconds between two images that are used."""
    gather: Expert[int] = Field(6, ge=2)
    """Number of clear images from which a mount's error is estimated jointly."""
    most_gathered: Expert[int] = Field(12, ge=2)
    """Maximum number of images to gather if fewer leave the error ambiguous."""
    judged: Expert[int] = Field(6, ge=1)
    """Number of most recent clear images that are checked for a slip once the mount's error is known."""
    slipped: Expert[int] = Field(4, ge=1)
    """Number of checked images (`judged`) that must contradict the mount before it is reported as slipped."""
    least_slip_deg: Expert[float] = Field(0.2, gt=0)
    """Minimum deviation in degrees for an image to contradict the mount."""
    slip_sigmas: Expert[float] = Field(3.0, gt=0)
    """Minimum deviation in standard deviations for an image to contradict the mount."""
    slip_sigma_deg: Expert[float] = Field(3.0, gt=0)
    """Standard deviation of the angles of a slip in degrees."""
