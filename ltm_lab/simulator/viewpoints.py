"""Draws where cameras stand and point: on seeded knolls and slopes, along walks, and as their sensors report it."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose
from ltm_lab.simulator.camera_setup import SensorConfig, ViewsConfig, WalkConfig
from ltm_lab.simulator.terrain_synthesis import HeightField


@dataclass(frozen=True)
class Report:
    """A frame as its camera reports it: `pose` with `covariance` (6, 6) of x, y, z (m) and rotations about them (rad),
    `stamp_ns` by the camera's clock, `received_ns` by the network's."""

    pose: Pose
    covariance: Float64Array
    stamp_ns: int
    received_ns: int

    @staticmethod
    def exact(pose: Pose, stamp_ns: int) -> "Report":
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

    def report(self, pose: Pose, stamp_ns: int) -> Report:
        """Return what the camera reports of a frame at the true `pose` and time."""
        c, rng = self._config, self._rng
        rng.uniform(size=3)  # drawn before the rest since the first recordings
        tilt, turn, shift, height = rng.normal(size=2), rng.normal(), rng.normal(size=2), rng.normal()
        azimuth, pitch, roll = pose.angles_deg
        east, north = self._gps + c.gps_sigma * shift
        position = pose.position + np.array([east, north, self._barometer + c.barometer_sigma * height])
        reported = Pose.from_angles(
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
        return Report(reported, np.diag([flat, flat, up, level, level, about]), stamp, stamp_ns)


@dataclass(frozen=True)
class Viewpoint:
    """One picture to take: eye (3,) in the map frame, angles and horizontal field of view in degrees."""

    eye: Float64Array
    azimuth_deg: float
    pitch_deg: float
    roll_deg: float
    hfov_deg: float


def draw_viewpoints(site: HeightField, config: ViewsConfig, seed: int) -> list[list[Viewpoint]]:
    """`config.positions` lists of `config.views` viewpoints; every other position is a knoll, the rest lie anywhere
    (`config.slopes`) or are knolls, too.

    Headings that look straight into the slope beside the camera are drawn again (eight times at most).
    """
    rng = np.random.default_rng([seed, 41])
    g = site.geometry
    size = g.width * g.resolution
    broad = ndimage.gaussian_filter(site.elevation, 180.0 / g.resolution)
    prominence = HeightField((site.elevation - broad).astype(np.float32), g)
    out: list[list[Viewpoint]] = []
    for i in range(config.positions):
        candidates = np.array([g.x_min, g.y_min]) + size * rng.uniform(
            0.08, 0.92, (1 if config.slopes and i % 2 else 60, 2)
        )
        x, y = candidates[int(np.argmax(prominence.at(candidates[:, 0], candidates[:, 1])))]
        eye = np.array([x, y, float(site.at(x, y)) + rng.uniform(*config.mast)])
        views = []
        for _ in range(config.views):
            pitch = rng.uniform(*config.pitch_deg)
            azimuth = 0.0
            for _ in range(8):
                azimuth = rng.uniform(0, 360)
                ahead = np.array([40.0, 90.0, 160.0])
                z = site.at(x + ahead * np.sin(np.radians(azimuth)), y + ahead * np.cos(np.radians(azimuth)))
                if np.all(z - eye[2] < ahead * np.tan(np.radians(max(pitch, -4.0) + 6.0))):
                    break
            views.append(Viewpoint(eye, azimuth, pitch, rng.uniform(*config.roll_deg), rng.uniform(*config.hfov_deg)))
        out.append(views)
    return out


def walked_stops(path: list[tuple[float, float]], stops: int) -> tuple[Float64Array, float]:
    """Places (stops, 2) at even distances along a path, its ends among them, and metres between two of them."""
    corners = np.array(path, np.float64)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], stops)
    places = np.column_stack([np.interp(at, along, corners[:, axis]) for axis in (0, 1)])
    return places, float(along[-1]) / (stops - 1)


def walk_photos(walk: WalkConfig, ground: HeightField, seed: int) -> list[tuple[float, Pose, bool]]:
    """Seconds since the start, true pose, and whether the phone is held upright (portrait), of each photo."""
    rng = np.random.default_rng([seed, 107, *walk.name.encode()])
    places, apart = walked_stops(walk.path, walk.stops)
    begins = apart / walk.speed + walk.interval_s * walk.photos
    photos = []
    for stop, (x, y) in enumerate(places):
        eye = np.array([x, y, float(ground.at(x, y)) + walk.eye])
        for k in range(walk.photos):
            number = stop * walk.photos + k
            pitch, roll = walk.sway_deg * rng.normal(size=2)
            pose = Pose.from_angles(
                eye,
                walk.azimuth_deg[number % len(walk.azimuth_deg)],
                walk.pitch_deg[number % len(walk.pitch_deg)] + pitch,
                roll,
            )
            photos.append((stop * begins + k * walk.interval_s, pose, walk.portrait[number % len(walk.portrait)]))
    return photos
