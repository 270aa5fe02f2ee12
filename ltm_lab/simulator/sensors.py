"""Errors of a camera's own sensors: position, attitude and time as phones and towers report them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose
from ltm_lab.simulator.camera_setup import SensorConfig


@dataclass(frozen=True)
class Report:
    """A frame as its camera tells it: `pose` with `covariance` (6, 6) over x, y, z (m) and rotations about them (rad),
    `stamp_ns` by the camera's clock, `received_ns` when it reaches the network."""

    pose: Pose
    covariance: Float64Array
    stamp_ns: int
    received_ns: int

    @staticmethod
    def exact(pose: Pose, stamp_ns: int) -> Report:
        """The truth, at once."""
        return Report(pose, np.zeros((6, 6)), stamp_ns, stamp_ns)


class SensorModel:
    """The sensors of one camera on one visit; its constant errors are drawn once, from the seed and both names."""

    def __init__(self, config: SensorConfig, name: str, seed: int) -> None:
        self._config = config
        self._rng = np.random.default_rng([seed, 83, *name.encode()])
        self._compass = config.compass_bias_deg * self._rng.normal()
        self._gps = config.gps_bias * self._rng.normal(size=2)
        self._barometer = config.barometer_bias * self._rng.normal()

    def report(self, pose: Pose, stamp_ns: int) -> Report | None:
        """What the camera says of a frame at the true `pose` and time; None where the frame is lost on its way."""
        c, rng = self._config, self._rng
        # The same draws whatever is lost, so that one setting does not change what another gives
        lost, late = rng.uniform() < c.lost, rng.uniform() < c.late
        delay, tilt, turn = c.late_s * rng.uniform(0.3, 1.0), rng.normal(size=2), rng.normal()
        shift, height = rng.normal(size=2), rng.normal()
        if lost:
            return None
        azimuth, pitch, roll = pose.angles_deg
        east, north = self._gps + c.gps_sigma * shift
        position = pose.position + np.array([east, north, self._barometer + c.barometer_sigma * height])
        told = Pose.from_angles(
            position,
            azimuth + self._compass + c.compass_sigma_deg * turn,
            pitch + c.tilt_sigma_deg * tilt[0],
            roll + c.tilt_sigma_deg * tilt[1],
        )
        flat = c.gps_bias**2 + c.gps_sigma**2
        up = c.barometer_bias**2 + c.barometer_sigma**2
        level = np.radians(c.tilt_sigma_deg) ** 2
        about = np.radians(np.hypot(c.compass_bias_deg, c.compass_sigma_deg)) ** 2
        stamp = stamp_ns + round(c.clock_offset_s * 1e9)
        received = stamp_ns + (round(delay * 1e9) if late else 0)
        return Report(told, np.diag([flat, flat, up, level, level, about]), stamp, max(received, 0))
