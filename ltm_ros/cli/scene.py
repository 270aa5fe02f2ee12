"""Open the terrain and cameras of a site, or of pose files; read the marks of `ltm locate`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import Float64Array
from ltm_core.cameras.camera_config import CalibrationConfig, PoseConfig
from ltm_core.fuel.prior import FuelPrior, load_prior
from ltm_core.geometry.geodesy import SiteFrame, ray_bend
from ltm_core.locating.region import marked_box, marked_pixel, marked_polygon
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sighting import Sighting
from ltm_core.raster.dem import Dem
from ltm_core.site.networks import site_scene_filter
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.surface.config import PoseErrorConfig
from ltm_core.tracing.trace_io import load_picture_config, set_up_picture
from ltm_core.visibility.point_visibility import PointVisibility
from ltm_core.visibility.viewshed import PosedCamera
from ltm_core.vision.masks import Looking
from ltm_ros.cli.output import numbers, open_dems, print_doubts


@dataclass(frozen=True, eq=False)
class ScenedCamera(PosedCamera):
    """A camera with its pose and pose covariance (6, 6)."""

    covariance: Float64Array


@dataclass(frozen=True, eq=False)
class Scene:
    """Terrain, and the cameras whose calibration and pose are known. `ground`: bare earth; `skipped`: the site's other
    cameras; `site`: None if it was made from pose files."""

    ground: Dem
    sight: PointVisibility
    frame: SiteFrame
    bend: float
    cameras: dict[str, ScenedCamera]
    skipped: tuple[str, ...] = ()
    site: Site | None = None

    @property
    def dem(self) -> Dem:
        """Return the surface that cameras see."""
        return self.sight.dem

    @property
    def config(self) -> LocatingConfig:
        return (self.site and self.site.locating) or LocatingConfig()

    def prior(self) -> FuelPrior | None:
        """Return the site's prior fuel map on its fuel grid."""
        if self.site is None or self.site.fuel.prior is None:
            return None
        geometry = self.site.fuel_geometry(self.ground)
        read = load_prior(self.site.fuel.prior, self.site.in_crs(geometry))
        return FuelPrior(read.codes, geometry, read.system)

    def camera(self, name: str) -> ScenedCamera:
        """Return a camera by name. Raises ConfigError that lists the cameras."""
        if name in self.cameras:
            return self.cameras[name]
        if name in self.skipped:
            raise ConfigError(
                f"camera {name!r} has no calibration or pose in the site file: give its pose file, --pose {name}=FILE"
            )
        raise ConfigError(f"no camera {name!r}; there are {', '.join([*self.cameras, *self.skipped]) or 'none'}")

    def named(self, text: str, option: str) -> tuple[str, str]:
        """Return camera and value of an argument `[CAMERA=]VALUE`. Raises ConfigError if it names none of several."""
        name, given, value = text.rpartition("=")
        if given:
            return name, value
        if len(self.cameras) != 1:
            raise ConfigError(
                f"{option} {text}: give the camera, {option} NAME={text}, one of {', '.join(self.cameras)}"
            )
        return next(iter(self.cameras)), value

    def sighting(self, name: str, text: str, smoke: bool) -> Sighting:
        """Return a mark; the count of numbers decides between pixel, box and polygon. Raises ConfigError."""
        seen_by, config, values = self.camera(name), self.config, numbers(text, "a mark")
        camera, mask = seen_by.camera, None
        if self.site is not None:
            looking = Looking.of(camera, seen_by.pose)
            mask = site_scene_filter(self.site, name).hidden(camera.width, camera.height, looking)
        if len(values) == 2:
            mark = marked_pixel(camera, values, config.pixel_sigma, mask)
        elif len(values) == 4:
            mark = marked_box(camera, values, config.pixel_sigma, config.box_sigma, smoke, mask)
        elif len(values) % 2 == 0:
            outline = np.array(values).reshape(-1, 2)
            mark = marked_polygon(camera, outline, config.pixel_sigma, config.box_sigma, smoke, mask)
        else:
            raise ConfigError(f"a mark is u,v, or u_min,v_min,u_max,v_max, or three or more points u,v; got {text!r}")
        return Sighting(name, camera, seen_by.pose, seen_by.covariance, mark)


def open_scene(site: Path | None, poses: Sequence[str], rasters: Sequence[Path] | None, crs: str | None) -> Scene:
    """Read a site, whose cameras' poses `NAME=FILE` replace, or cameras from pose files `[NAME=]FILE` over rasters.

    Raises ConfigError, RasterError, PoseError."""
    if site is not None:
        return _of_site(load_site(site), poses)
    if not poses:
        raise ConfigError("give --site S.yaml, or --pose P.yaml with --dem D.tif")
    if not rasters:
        raise ConfigError("--pose without --site needs the terrain, too: give --dem D.tif")
    terrain = open_dems(rasters, crs)
    named = [text.partition("=")[::2] if "=" in text else (Path(text).stem, text) for text in poses]
    configs = {name: load_picture_config(path) for name, path in named}
    first = next(iter(configs.values()))
    setup = set_up_picture(first, terrain)
    for doubt in setup.doubts:
        typer.secho(doubt, fg="yellow", err=True)
    stated = {name: (config.calibration, config.pose) for name, config in configs.items()}
    cameras = _placed(stated, setup.dem, setup.frame, PoseErrorConfig())
    sight = PointVisibility(setup.dem, first.curvature, first.refraction, first.possible_ground)
    return Scene(setup.dem, sight, setup.frame, ray_bend(first.curvature, first.refraction), cameras)


def _of_site(site: Site, poses: Sequence[str]) -> Scene:
    ground = site.open_dem()
    surface = print_doubts(site.open_surface(ground))
    stated = {name: (camera.calibration, camera.pose) for name, camera in site.cameras.items()}
    for text in poses:
        name, _, path = text.partition("=")
        if not path:
            raise ConfigError(f"--pose {text!r}: with --site, give the camera's name: --pose north=north.yaml")
        if name not in stated:
            raise ConfigError(f"--pose {name}: site {site.name} has no such camera; it has {', '.join(site.cameras)}")
        known = load_picture_config(Path(path))
        stated[name] = known.calibration, known.pose
    cameras = _placed(stated, ground, site.frame, site.assumed_pose_error)
    skipped = tuple(name for name in stated if name not in cameras)
    sight = PointVisibility(surface, site.curvature, site.refraction, site.possible_ground)
    return Scene(ground, sight, site.frame, site.bend, cameras, skipped, site)


_Stated = Mapping[str, tuple[CalibrationConfig | None, PoseConfig | None]]


def _placed(stated: _Stated, dem: Dem, frame: SiteFrame, assumed: PoseErrorConfig) -> dict[str, ScenedCamera]:
    """Return the cameras that have both a calibration and a pose. `assumed`: errors of poses that state none."""
    cameras = {}
    for name, (calibration, config) in stated.items():
        if calibration is not None and config is not None:
            pose = config.pose(dem, frame)
            covariance = config.covariance(pose, assumed.position, assumed.angle_deg)
            covariance = assumed.covariance() if covariance is None else covariance
            cameras[name] = ScenedCamera(name, calibration.camera(), pose, covariance)
    return cameras
