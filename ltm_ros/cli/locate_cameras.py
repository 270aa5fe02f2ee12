"""Read the cameras, terrain and marks that `ltm locate` works on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import BoolArray, Float64Array
from ltm_core.fuel.prior import FuelPrior
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame, ray_bend
from ltm_core.geometry.pose import Pose
from ltm_core.locating.region import marked_box, marked_pixel, marked_polygon
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sighting import Sighting
from ltm_core.raster.dem import Dem
from ltm_core.site.networks import site_scene_filter
from ltm_core.surface.config import PoseErrorConfig
from ltm_core.visibility.point_visibility import PointVisibility
from ltm_core.visibility.viewshed import PosedCamera
from ltm_ros.cli.output import open_dems, print_doubts


def numbers(text: str, option: str, counts: tuple[int, ...] = ()) -> list[float]:
    """Return comma-separated numbers. Raises ConfigError if their count is not one that the option accepts."""
    try:
        values = [float(part) for part in text.replace(";", ",").replace(" ", ",").split(",") if part]
    except ValueError as error:
        raise ConfigError(f"{option} must be numbers separated by commas, got {text!r}") from error
    if not all(math.isfinite(value) for value in values) or (counts and len(values) not in counts) or not values:
        wanted = f"{' or '.join(map(str, counts))} " if counts else ""
        raise ConfigError(f"{option} needs {wanted}finite numbers separated by commas, got {text!r}")
    return values


@dataclass(frozen=True, eq=False)
class LocatingCamera:
    """A camera with its pose and pose covariance (6, 6). `hidden`: (H, W), True for masked pixels; None: no mask."""

    name: str
    camera: Camera
    pose: Pose
    covariance: Float64Array
    hidden: BoolArray | None = None

    @property
    def posed(self) -> PosedCamera:
        return PosedCamera(self.name, self.camera, self.pose)


@dataclass(frozen=True, eq=False)
class LocatingScene:
    """Terrain and cameras. `skipped`: cameras of the site whose pose or calibration are topics."""

    dem: Dem
    sight: PointVisibility
    frame: SiteFrame
    bend: float
    config: LocatingConfig
    prior: FuelPrior | None
    cameras: dict[str, LocatingCamera]
    skipped: tuple[str, ...] = field(default=())

    def camera(self, name: str) -> LocatingCamera:
        """Return a camera by name. Raises ConfigError that lists the cameras."""
        if name in self.cameras:
            return self.cameras[name]
        if name in self.skipped:
            raise ConfigError(
                f"camera {name!r} has no calibration or pose in the site file: give its pose file, --pose {name}=FILE"
            )
        raise ConfigError(f"no camera {name!r}; there are {', '.join([*self.cameras, *self.skipped]) or 'none'}")


def of_site(path: Path, poses: Sequence[str]) -> LocatingScene:
    """Read a site; pose files `NAME=FILE` add or replace the poses of its cameras."""
    from ltm_core.fuel.prior import load_prior
    from ltm_core.site.site_io import load_site
    from ltm_core.tracing.trace_io import load_picture_config
    from ltm_core.vision.masks import Looking

    site = load_site(path)
    ground = site.open_dem()
    dem = print_doubts(site.open_surface(ground))
    assumed = site.assumed_pose_error
    files = dict(_named(text) for text in poses)
    cameras: dict[str, LocatingCamera] = {}
    skipped = []
    for name, camera in site.cameras.items():
        calibration, pose = camera.calibration, camera.pose
        if name in files:
            known = load_picture_config(files.pop(name))
            calibration, pose = known.calibration, known.pose
        if calibration is None or pose is None:
            skipped.append(name)
            continue
        placed = pose.pose(ground, site.frame)
        stated = pose.covariance(placed, assumed.position, assumed.angle_deg)
        covariance = assumed.covariance() if stated is None else stated
        model = calibration.camera()
        hidden = site_scene_filter(site, name).hidden(model.width, model.height, Looking.of(model, placed))
        cameras[name] = LocatingCamera(name, model, placed, covariance, hidden)
    if files:
        raise ConfigError(
            f"--pose {', '.join(files)}: site {site.name} has no such camera; it has {', '.join(site.cameras)}"
        )
    prior = None
    if site.fuel.prior is not None:
        geometry = site.fuel_geometry(ground)
        read = load_prior(site.fuel.prior, site.in_crs(geometry))
        prior = FuelPrior(read.codes, geometry, read.system)
    sight = PointVisibility(dem, site.curvature, site.refraction, site.possible_ground)
    config = site.locating or LocatingConfig()
    return LocatingScene(dem, sight, site.frame, site.bend, config, prior, cameras, tuple(skipped))


def of_poses(paths: Sequence[str], rasters: Sequence[Path], crs: str | None) -> LocatingScene:
    """Read cameras from pose files, `FILE` or `NAME=FILE`, over one terrain; refraction is that of the first."""
    from ltm_core.tracing.trace_io import load_picture_config, near_frame

    if not rasters:
        raise ConfigError("--pose without --site needs the terrain, too: give --dem D.tif")
    terrain = open_dems(rasters, crs)
    named = [_named(text) if "=" in text else (Path(text).stem, Path(text)) for text in paths]
    configs = {name: load_picture_config(path) for name, path in named}
    first = next(iter(configs.values()))
    frame, dem = near_frame(first, terrain)
    assumed = PoseErrorConfig()
    cameras = {}
    for name, known in configs.items():
        pose = known.pose.pose(dem, frame)
        stated = known.pose.covariance(pose, assumed.position, assumed.angle_deg)
        covariance = assumed.covariance() if stated is None else stated
        cameras[name] = LocatingCamera(name, known.calibration.camera(), pose, covariance)
    sight = PointVisibility(dem, first.curvature, first.refraction, first.possible_ground)
    bend = ray_bend(first.curvature, first.refraction)
    return LocatingScene(dem, sight, frame, bend, LocatingConfig(), None, cameras)


def _named(text: str) -> tuple[str, Path]:
    name, given, path = text.partition("=")
    if not given or not name or not path:
        raise ConfigError(f"--pose {text!r}: with --site, give the camera's name: --pose north=north.yaml")
    return name, Path(path)


def named(text: str, option: str, scene: LocatingScene) -> tuple[str, str]:
    """Return the camera and the value of an argument `[CAMERA=]VALUE`. Raises ConfigError if there are several
    cameras."""
    name, given, value = text.rpartition("=")
    if given:
        return name, value
    if len(scene.cameras) != 1:
        raise ConfigError(f"{option} {text}: give the camera, {option} NAME={text}, one of {', '.join(scene.cameras)}")
    return next(iter(scene.cameras)), value


def marked(scene: LocatingScene, name: str, text: str, smoke: bool) -> Sighting:
    """Return a mark; the count of numbers decides between pixel, box and polygon. Raises ConfigError."""
    camera, config = scene.camera(name), scene.config
    values, mask = numbers(text, "a mark"), camera.hidden
    if len(values) == 2:
        mark = marked_pixel(camera.camera, values, config.pixel_sigma, mask)
    elif len(values) == 4:
        mark = marked_box(camera.camera, values, config.pixel_sigma, config.box_sigma, smoke, mask)
    elif len(values) % 2 == 0:
        outline = np.array(values).reshape(-1, 2)
        mark = marked_polygon(camera.camera, outline, config.pixel_sigma, config.box_sigma, smoke, mask)
    else:
        raise ConfigError(f"a mark is u,v, or u_min,v_min,u_max,v_max, or three or more points u,v; got {text!r}")
    return Sighting(name, camera.camera, camera.pose, camera.covariance, mark)
