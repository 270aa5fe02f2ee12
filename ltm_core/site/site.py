"""Typed configuration of one site. Defaults are defined here and in the sections, and nowhere else."""

import re
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from ltm_core.base.errors import ConfigError, RasterError
from ltm_core.base.strict_model import Expert, StrictModel
from ltm_core.geometry.geodesy import SiteFrame, ray_bend
from ltm_core.geometry.grid import GridGeometry
from ltm_core.locating.settings import LocatingConfig
from ltm_core.pose_estimation.mount.mount_config import PoseRefinementConfig
from ltm_core.raster.dem import Dem
from ltm_core.raster.dem_stack import open_terrain, sampled, shared, with_surface
from ltm_core.raster.heights_check import doubt_of_surface
from ltm_core.site.sections import (
    AlertsConfig,
    CameraConfig,
    DemConfig,
    FuelConfig,
    HealthConfig,
    MessageLimits,
    WatchdogConfig,
)
from ltm_core.surface.config import PoseErrorConfig, TerrainConfig
from ltm_core.tracing.possible_ground import PossibleGround
from ltm_core.uplink.config import UplinkConfig
from ltm_core.vision.manifest import DEFAULT_MODEL


def _ros_name(name: str) -> str:
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ValueError(f"{name!r} is used in topic names: use a-z, 0-9 and _, starting with a letter")
    return name


RosName = Annotated[str, AfterValidator(_ros_name)]

FARTHEST_ORIGIN = 100_000.0
"""Maximum distance in metres from the DEM to the origin; beyond it, float32 coordinates lose centimetres."""

SITE_NAMES = ("fuel_map", "terrain", "locate", "viewer", "recorder", "health", "uplink", "prompt")
"""Names of nodes and topics in `/<site>/`, which no camera may have."""


def _camera_name(name: str) -> str:
    if name in SITE_NAMES:
        raise ValueError(f"{name!r} is the name of a node; choose another name for the camera")
    return name


CameraName = Annotated[RosName, AfterValidator(_camera_name)]


def _some_camera(cameras: dict[str, CameraConfig]) -> dict[str, CameraConfig]:
    if not cameras:
        raise ValueError("no camera: add one with `ltm cameras probe ADDRESS --site SITE --camera NAME`")
    return cameras


Cameras = Annotated[dict[CameraName, CameraConfig], AfterValidator(_some_camera)]


def _projected_crs(crs: str) -> str:
    try:
        SiteFrame(crs)
    except ConfigError as error:
        raise ValueError(str(error)) from error
    return crs


ProjectedCrs = Annotated[str, AfterValidator(_projected_crs)]


class Site(StrictModel):
    name: RosName
    """Name of the site, the first part of its topic names: a-z, 0-9 and _."""
    crs: ProjectedCrs
    """Projected CRS in metres of all coordinates in this file, for example the UTM zone."""
    origin: tuple[float, float]
    """Origin (x, y) of the map frame in the CRS, in metres; near the site, so that float32 resolves millimetres."""
    dem: DemConfig
    """The DEM; in YAML a single one, or a list from the finest to the coarsest (see `dem_stack`)."""
    coarser: tuple[DemConfig, ...] = ()
    """The coarser DEMs of such a list."""
    surface: DemConfig | None = None
    """Raster of the tops of trees and buildings, in metres; where it is nodata, the ground is used."""
    curvature: Expert[bool] = True
    """Whether rays follow the curvature of the earth."""
    refraction: Expert[float] = Field(0.13, ge=0, lt=1)
    """Refraction coefficient of the air, as a share of the curvature."""
    possible_ground: PossibleGround = PossibleGround()
    """Maximum height of ground that the DEM does not cover; it decides which pixels are sky."""
    fuel: FuelConfig = FuelConfig()
    """Fuel map of the site."""
    assumed_pose_error: Expert[PoseErrorConfig] = PoseErrorConfig()
    """Standard deviations of poses that state no covariance."""
    terrain: TerrainConfig | None = None
    """Settings of the updated terrain; if given, fused depth keeps the surface up to date."""
    locating: LocatingConfig | None = None
    """Settings for locating marks in camera images on the map; None: the node does not run."""
    labels: Expert[str] = "labels.yaml"
    """Label set, a file in config/."""
    model: str = DEFAULT_MODEL
    """Segmentation manifest: a name in config/models/ or a path."""
    vocabulary: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    """Prompts by label for a network that takes text; pixels of the prompts of `other` stay unlabelled."""
    label_heads: Expert[Path | None] = None
    """Folder of label heads that is searched before that of the network's manifest, relative to the site file."""
    depth_model: str = ""
    """Manifest of a depth network: a name or a path. If given, traced depth is fused with it (`fused/depth`)."""
    cameras: Cameras = Field(default_factory=dict, validate_default=True)
    """Cameras of the site by name."""
    processes: Expert[Literal["site", "node"]] = "site"
    """How nodes share processes. `site`: the nodes of all cameras share one process, terrain and networks. `node`: each
    node has its own process, for development and for several hosts."""
    workers: Expert[int | None] = Field(None, ge=1)
    """Number of frames that a site's process works on at a time; None: one per core."""
    refine_poses: PoseRefinementConfig | None = None
    """Settings for refining poses; None: poses are used as stated."""
    limits: Expert[MessageLimits] = MessageLimits()
    """Maximum sizes of messages."""
    watchdog: Expert[WatchdogConfig] = WatchdogConfig()
    """Times after which a process is restarted."""
    health: HealthConfig | None = None
    """Settings of the HTTP endpoint of `ltm run` for monitoring systems and the status page; None: no endpoint."""
    alerts: AlertsConfig | None = None
    """Receivers of messages on changes of state, which the node `health` sends; None: nothing is sent."""
    region: UplinkConfig | None = None
    """Settings for sending votes to the map of a region; None: they are not sent."""
    nodes: dict[RosName, dict[str, Any]] = Field(default_factory=dict)
    """Parameters by node type, such as `{capture: {pose_tolerance: 0.1}}`; a node rejects unknown ones."""

    @model_validator(mode="before")
    @classmethod
    def _finest_first(cls, data: Any) -> Any:
        if not (isinstance(data, dict) and isinstance(data.get("dem"), list)):
            return data
        if not data["dem"] or "coarser" in data:
            raise ValueError("dem is one raster, or a list of them from the finest to the coarsest")
        finest, *coarser = data["dem"]
        return {**data, "dem": finest, "coarser": coarser}

    @model_validator(mode="before")
    @classmethod
    def _health_for_alerts(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("alerts") and data.get("health") is None:
            return {**data, "health": {}}
        return data

    @property
    def frame(self) -> SiteFrame:
        return SiteFrame(self.crs, *self.origin)

    @property
    def bend(self) -> float:
        return ray_bend(self.curvature, self.refraction)

    def open_dem(self) -> Dem:
        """Return the bare earth in the map frame, shared within the process; a `DemStack` where the site has coarser
        rasters too.

        Raises RasterError as `open_terrain` and `Dem.in_frame` do, ConfigError where the origin is far from it."""
        rasters = [(dem.path, dem.crs) for dem in (self.dem, *self.coarser)]

        def read() -> Dem:
            dem = open_terrain(rasters)
            local = self._in_frame(dem, self.dem.path)
            self._check_origin(dem.geometry)
            return local

        return shared([path for path, _ in rasters], (*(crs for _, crs in rasters), self.frame), read)

    def _check_origin(self, terrain: GridGeometry) -> None:
        """`terrain`: in the site's CRS."""
        x, y = self.origin
        away = terrain.distance_to(x, y)
        if away <= FARTHEST_ORIGIN:
            return
        swapped = terrain.distance_to(y, x) <= FARTHEST_ORIGIN
        x_middle, y_middle = (terrain.x_min + terrain.x_max) / 2, (terrain.y_min + terrain.y_max) / 2
        wanted = f"[{y:.10g}, {x:.10g}]" if swapped else f"[{round(x_middle, -3):.0f}, {round(y_middle, -3):.0f}]"
        raise ConfigError(
            f"origin [{x:.10g}, {y:.10g}] is {away / 1000:.0f} km from the DEM, which covers "
            f"{terrain.described()}: "
            + ("x and y are swapped, write " if swapped else "it must lie near the site, such as ")
            + wanted
        )

    def open_surface(self, ground: Dem) -> Dem:
        """Return the surface that cameras see, in the map frame: `ground` (of `open_dem`) with the tops of trees and
        buildings if the site has a surface raster.

        Raises RasterError as `Dem.open` does, and for heights that are not those of a surface over this ground."""
        given = self.surface
        if given is None:
            return ground

        def read() -> Dem:
            tops = self._in_frame(Dem.open(given.path, given.crs), given.path)
            over = tops.geometry
            doubt = doubt_of_surface(sampled(tops, over), sampled(ground, over), str(given.path))
            doubts = tops.doubts if doubt is None else (*tops.doubts, doubt.required())
            kept = tuple(doubt for doubt in doubts if doubt.code != "steep")  # as trees are
            return with_surface(ground, Dem(tops.elevation, tops.geometry, kept))

        rasters = [dem.path for dem in (given, self.dem, *self.coarser)]
        way = ("surface", given.crs, self.dem.crs, *(dem.crs for dem in self.coarser), self.frame)
        return shared(rasters, way, read)

    def _in_frame(self, dem: Dem, path: Path) -> Dem:
        try:
            return dem.in_frame(self.frame)
        except RasterError as error:
            raise RasterError(f"{path}: {error}") from error

    def fuel_geometry(self, dem: Dem) -> GridGeometry:
        """Return the fuel grid over the DEM (given in the map frame), in the map frame, snapped in the site's CRS."""
        x, y = self.origin
        x_min, y_min, x_max, y_max = dem.geometry.bounds
        snapped = GridGeometry.snapped(
            (x_min + x, y_min + y, x_max + x, y_max + y), self.fuel.resolution, self.fuel.phase
        )
        return self.in_map(snapped)

    def in_crs(self, geometry: GridGeometry) -> GridGeometry:
        """Return a raster of the map frame as a raster of the site's CRS, for files."""
        return geometry.translated(*self.origin, crs=self.crs)

    def in_map(self, geometry: GridGeometry) -> GridGeometry:
        """Return a raster of the site's CRS as a raster of the map frame."""
        x, y = self.origin
        return geometry.translated(-x, -y)

    def camera(self, name: str) -> CameraConfig:
        """Return a camera. Raises ConfigError with the list of cameras."""
        if name not in self.cameras:
            raise ConfigError(f"site {self.name} has no camera {name!r}; it has {', '.join(self.cameras)}")
        return self.cameras[name]
