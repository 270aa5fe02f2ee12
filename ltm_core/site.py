"""Typed configuration of one site: terrain, frame, fuel grid and cameras. Defaults stand here and nowhere else."""

from __future__ import annotations

import ipaddress
import math
import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from ltm_core.camera_config import CalibrationConfig, PoseConfig
from ltm_core.dem import Dem
from ltm_core.errors import ConfigError, RasterError
from ltm_core.fuel.prior_config import PriorConfig
from ltm_core.fuel.rules import FusionRules
from ltm_core.geodesy import SiteFrame, ray_bend
from ltm_core.grid import GridGeometry
from ltm_core.locating.settings import LocatingConfig
from ltm_core.pose_estimation.mount_config import MountConfig
from ltm_core.ptz_config import PtzConfig
from ltm_core.raster.dem_stack import open_terrain, with_surface
from ltm_core.raster.shared_rasters import shared
from ltm_core.sensor_pose import SensorsConfig
from ltm_core.source_config import NetworkSettings, SnapshotConfig, SourceConfig
from ltm_core.tracing.possible_ground import PossibleGround
from ltm_core.types import Float64Array
from ltm_core.vision.label_head import SHIPPED_HEAD
from ltm_core.vision.mask_config import MaskConfig


def _ros_name(name: str) -> str:
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ValueError(f"{name!r} becomes part of topic names: use a-z, 0-9 and _, starting with a letter")
    return name


RosName = Annotated[str, AfterValidator(_ros_name)]

FARTHEST_ORIGIN = 100_000.0
"""Metres from the DEM to the origin: beyond it, float32 coordinates no longer hold centimetres."""

SITE_NAMES = ("fuel_map", "terrain", "locate", "viewer", "recorder", "health")
"""Nodes and topics that stand beside the cameras in `/<site>/`: no camera may be called so."""


def _camera_name(name: str) -> str:
    if name in SITE_NAMES:
        raise ValueError(f"{name!r} is a node of the site, so no camera can have this name")
    return name


CameraName = Annotated[RosName, AfterValidator(_camera_name)]


def _projected_crs(crs: str) -> str:
    try:
        SiteFrame(crs)
    except ConfigError as error:
        raise ValueError(str(error)) from error
    return crs


ProjectedCrs = Annotated[str, AfterValidator(_projected_crs)]


class Config(BaseModel):
    """Base of all configuration: unknown keys are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, protected_namespaces=(), allow_inf_nan=False)


class DemConfig(Config):
    path: Path
    """Raster file, relative to the site file."""
    crs: str | None = None
    """Only for a raster that carries none."""


class FuelConfig(Config):
    resolution: float = Field(30.0, gt=0)
    """Cell size, metres; LANDFIRE's is 30."""
    phase: float = 15.0
    """Cell edges lie at phase mod resolution in the site's CRS; LANDFIRE's at 15 mod 30."""
    max_range: float = Field(6000.0, gt=0)
    """Metres beyond which a pixel's footprint is too coarse to vote for a cell."""
    prior: PriorConfig | None = None
    """The fuel map that evidence starts from; None: nothing is known before it is seen."""
    region: str = "dry"
    """Which codes changed cells get: a name in config/fuel/regions/."""
    fusion: FusionRules = FusionRules()
    """How evidence is weighed and when a cell changes."""
    label_errors: str | None = None
    """What the network takes for what, and how its errors correlate: a YAML file; None: its calibration."""


class PoseErrorConfig(Config):
    """Standard deviations of a pose that comes without a covariance."""

    angle_deg: float = Field(0.3, gt=0)
    """Of each angle. What surveyed mounts keep; a phone's compass is off by five degrees, and should say so."""
    position: float = Field(0.5, gt=0)
    """Metres, of each coordinate."""

    def covariance(self) -> Float64Array:
        """(6, 6): position, then rotation about the map's axes, in metres and radians."""
        return np.diag([self.position**2] * 3 + [math.radians(self.angle_deg) ** 2] * 3)


class Limits(Config):
    """How large messages may be; what is larger is dropped, and counted as `too_large`, before anything is made of it.

    So that each node stays below a gigabyte at the bound (`ltm bench bounds`).
    """

    image_bytes: int = Field(32 << 20, ge=1)
    """Size of a compressed image."""
    pixels: int = Field(12_600_000, ge=1)
    """Number in an image and in a calibration: the depth of a pixel takes 44 bytes while it is traced."""
    waiting_bytes: int = Field(128 << 20, ge=1)
    """Size of the image data that waits in a node for the other messages of its frame."""


class WatchdogConfig(Config):
    """When the runner takes a node for hung, kills it and starts it again. Seconds in which both run."""

    silent: float = Field(8.0, ge=2)
    """Without a sign of life, while it neither computes nor waits for a core or a disk: stopped, or deadlocked with
    Python's lock in hand."""
    stuck: float = Field(120.0, ge=2)
    """On one message, or in one callback of its executor."""
    slow: float = Field(600.0, ge=2)
    """For what may take long: the start (kernels are compiled, the DEM is read), what a service was asked for, the end.
    After each start in a row that was too slow, the next has twice as long."""


class PoseRefinementConfig(Config):
    """How the poses of mounted cameras are kept by their pictures; a site that has this section runs the node `pose`
    for each camera. Angles in degrees."""

    every: float = Field(10.0, ge=0)
    """Seconds between two pictures that are looked at."""
    gather: int = Field(6, ge=2)
    """Clear pictures in which a mount's error is sought together,"""
    most_gathered: int = Field(12, ge=2)
    """and at most so many, where they leave it open."""
    judged: int = Field(6, ge=1)
    """Of a mount whose error is known, so many of the last clear pictures are judged by;"""
    slipped: int = Field(4, ge=1)
    """where so many of them say that the camera looks elsewhere, it has slipped."""
    least_slip_deg: float = Field(0.2, gt=0)
    """A picture says so where it is off by more than this"""
    slip_sigmas: float = Field(3.0, gt=0)
    """and by so many of its standard deviations,"""
    slip_sigma_deg: float = Field(3.0, gt=0)
    """and this is the standard deviation of a slip's angles."""


class TerrainConfig(Config):
    """The living terrain; a site that has this section runs the node `terrain`. Lengths in metres, times in seconds."""

    resolution: float | None = Field(None, gt=0)
    """Cell size; None: the DEM's."""
    min_range: float = Field(20.0, ge=0)
    """Anything nearer is taken for an object close to the lens and ignored."""
    max_range: float = Field(1500.0, gt=0)
    """Beyond it, depth is too coarse to move a cell."""
    columns: int = Field(960, ge=1)
    """Of an image, at most so many are used, evenly spaced, and rows as far apart."""
    threshold: float = Field(1.5, gt=0)
    """Change of height that is worth reporting."""
    confidence: float = Field(3.0, gt=0)
    """Standard deviations by which a change must be sure; also the gate between agreement and contradiction."""
    alone: float = Field(5.0, gt=0)
    """Those by which a change must be sure that one camera alone has seen: a network is off by more than five of its
    sigmas about as often as noise is by more than three, and two cameras seldom in the same place."""
    min_area: float = Field(25.0, ge=0)
    """Square metres of connected change; less is left out."""
    reference_sigma: float = Field(0.3, gt=0)
    """Of the heights of the DEM and of the surface raster."""
    independent_after: float = Field(3600.0, gt=0)
    """Two looks of one camera are independent when they are that far apart."""
    settle: float = Field(600.0, ge=0)
    """Two cameras must agree over at least that long: what moves is gone by then."""
    repeated_error_share: float = Field(0.95, ge=0, le=1)
    """Of the variance of a depth, what each look of a camera has alike, which no number of them averages out. A network
    sees the same scene alike in any light; 0: depth whose errors are new each time, as a range finder's (then `alone`
    need not be more than `confidence`)."""
    memory: float = Field(8.0, ge=1)
    """Looks that a cell's mean remembers."""
    lasting: float = Field(365.0 * 86400.0, gt=0)
    """Time in which a look loses all but 1/e of its weight: over years, plants grow and rivers move their banks."""
    tallest: float = Field(60.0, gt=0)
    """Nothing on the ground is higher: smoke, birds and aircraft are."""
    register_frames: bool = True
    """Turn each frame, within its pose's uncertainty, so that it agrees best with the reference."""
    cache_mb: float = Field(100.0, ge=32)
    """Memory for cells; the others wait in the store."""
    views_mb: float = Field(34.0, ge=0)
    """Memory for what the reference shows in the pixels of cameras that stand still: 17 MB each at 1080p."""


class CameraConfig(Config):
    image: Literal["compressed", "raw"] = "compressed"
    """`image_raw/compressed` (JPEG or PNG) or `image_raw`."""
    calibration: CalibrationConfig | None = None
    """None: from the camera_info topic."""
    pose: PoseConfig | None = None
    """None: from the pose topic."""
    sensors: SensorsConfig | None = None
    """Instead of the pose topic: from the topics `fix` (NavSatFix) and `imu` (Imu)."""
    mask: MaskConfig | None = None
    """What of a fixed camera's pictures never shows the landscape: a PNG in the site file's folder, or polygons; see
    `ltm mask`. None: nothing of them."""
    head: str = SHIPPED_HEAD
    """Head of the segmentation network for what this camera sees: `landscape` is the network's own, others are taught
    (`ltm train head`); a name, or a path from the site's folder of heads."""
    mount: MountConfig | None = None
    """Of a pan-tilt-zoom head: what makes poses, and where it zooms calibrations, of what its encoders say."""
    ptz: PtzConfig | None = None
    """How the head is asked where it looks, and which presets it is driven to; needs `mount`."""
    source: SourceConfig | None = None
    """Where given, the node `source` asks the camera for its pictures and publishes them; None: a driver does."""
    judge_pictures: bool = True
    """Tell pictures by night, in fog or glare, blank or blurred ones from usable ones; they do not vote, move the
    terrain or fit the pose."""

    @model_validator(mode="after")
    def _one_pose(self) -> Self:
        given = [name for name in ("pose", "sensors", "mount") if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(
                f"give either {' or '.join(given)}, not both: a camera is fixed (pose), turns on a head (mount), or "
                "its sensors tell where it is (sensors)"
            )
        if self.mount is not None and self.mount.lens is not None and self.calibration is not None:
            raise ValueError("give either calibration or mount.lens, not both: the lens zooms, or it does not")
        return self

    @model_validator(mode="after")
    def _ptz_needs(self) -> Self:
        if self.ptz is None:
            return self
        if self.mount is None:
            raise ValueError("ptz needs mount: what makes a pose of what the head says")
        if self.source is None:
            raise ValueError("ptz needs source: a head is asked where it looks before and after each picture")
        if self.ptz.patrol is not None and not isinstance(self.source, SnapshotConfig):
            raise ValueError(
                f"a patrol needs a source of kind snapshot, which is asked at each preset, not {self.source.kind}"
            )
        if self.ptz.url is None and not isinstance(self.source, NetworkSettings):
            raise ValueError(f"a source of kind {self.source.kind} has no address: write that of the head as ptz.url")
        return self

    @model_validator(mode="after")
    def _source_needs(self) -> Self:
        if self.source is None:
            return self
        if self.calibration is None and (self.mount is None or self.mount.lens is None):
            raise ValueError("a camera with a source needs its calibration here: width, height and hfov_deg or fx")
        if self.image == "raw" and self.source.kind != "rtsp":
            raise ValueError(f"a source of kind {self.source.kind} publishes the camera's JPEGs: leave image out")
        return self


class HealthConfig(Config):
    """Where a tower answers monitoring systems; a site that has this section runs the node `health`."""

    port: int = Field(9464, ge=0, le=65535)
    """TCP; 0: any that is free."""
    address: str = "127.0.0.1"
    """IP address to listen on. Any but this machine's own loopback needs `certificate`, `key` and `token`."""
    certificate: Path | None = None
    """PEM, with the chain; relative to the site file."""
    key: Path | None = None
    """PEM. A systemd credential of the file's name goes before the file."""
    token: Path | None = None
    """File with the token that must be known (`Authorization: Bearer ...`); a credential goes before it, too."""
    frame_age: float = Field(120.0, gt=0)
    """Seconds; a camera whose newest frame is older is not ready."""

    @model_validator(mode="after")
    def _closed_to_strangers(self) -> Self:
        try:
            local = ipaddress.ip_address(self.address).is_loopback
        except ValueError as error:
            raise ValueError(f"address {self.address!r}: give an IP address, such as 127.0.0.1") from error
        if (self.certificate is None) != (self.key is None):
            raise ValueError("give certificate and key together")
        if not local and (self.certificate is None or self.token is None):
            raise ValueError(
                f"address {self.address} is not this machine alone: give certificate, key and token, or 127.0.0.1"
            )
        return self


class Site(Config):
    name: RosName
    crs: ProjectedCrs
    origin: tuple[float, float]
    """(x, y) in the CRS that is (0, 0) of the map frame; near the site, so that float32 holds millimetres."""
    dem: DemConfig
    """One, or in YAML a list: the finest first, then coarser ones around it (see `dem_stack`)."""
    coarser: tuple[DemConfig, ...] = ()
    """The rest of such a list."""
    surface: DemConfig | None = None
    """Tops of trees and houses as elevations; where it is nodata the ground shows."""
    curvature: bool = True
    refraction: float = Field(0.13, ge=0, lt=1)
    possible_ground: PossibleGround = PossibleGround()
    """How high the ground may be where the DEM does not know it, beyond its end too: what is sky hangs on it."""
    fuel: FuelConfig = FuelConfig()
    assumed_pose_error: PoseErrorConfig = PoseErrorConfig()
    terrain: TerrainConfig | None = None
    """Where given, the surface is kept up to date from fused depth."""
    locating: LocatingConfig | None = None
    """Where given, what is marked in the cameras' pictures is located on the map."""
    labels: str = "labels.yaml"
    """Label set in config/."""
    model: str = "landscape_lite0"
    """Segmentation manifest: a name in config/models/ or a path."""
    heads: Path | None = None
    """Folder of heads that is looked in first, relative to the site file; then beside the network's manifest."""
    depth_model: str = ""
    """Manifest of a depth network, likewise; where given, traced depth is fused with it (`fused/depth`)."""
    cameras: dict[CameraName, CameraConfig] = Field(min_length=1)
    processes: Literal["site", "node"] = "site"
    """`site`: the nodes of all cameras share one process: a frame runs straight through them, terrain and networks are
    there once. `node`: each node has a process of its own, for development, and for several hosts."""
    workers: int | None = Field(None, ge=1)
    """Threads that work on frames in a site's process, each on one frame at a time; None: one for each core."""
    refine_poses: PoseRefinementConfig | None = None
    """None: poses are taken as they are stated."""
    limits: Limits = Limits()
    watchdog: WatchdogConfig = WatchdogConfig()
    health: HealthConfig | None = None
    """Where given, `ltm run` answers monitoring systems there, and serves the status page."""
    nodes: dict[RosName, dict[str, Any]] = {}
    """Parameters a node type: `nodes: {capture: {pose_tolerance: 0.1}}`. Each node refuses what it does not know."""

    @model_validator(mode="before")
    @classmethod
    def _finest_first(cls, data: Any) -> Any:
        if not (isinstance(data, dict) and isinstance(data.get("dem"), list)):
            return data
        if not data["dem"] or "coarser" in data:
            raise ValueError("dem is one raster, or a list of them from the finest to the coarsest")
        finest, *coarser = data["dem"]
        return {**data, "dem": finest, "coarser": coarser}

    @property
    def frame(self) -> SiteFrame:
        return SiteFrame(self.crs, *self.origin)

    @property
    def bend(self) -> float:
        return ray_bend(self.curvature, self.refraction)

    def open_dem(self) -> Dem:
        """The bare earth in the map frame, shared within the process; a `DemStack` where the site has coarser rasters
        too.

        Raises RasterError as `open_terrain` and `Dem.in_frame` do, ConfigError where the origin is far from it.
        """
        rasters = [(dem.path, dem.crs) for dem in (self.dem, *self.coarser)]

        def read() -> Dem:
            dem = open_terrain(rasters)
            try:
                local = dem.in_frame(self.frame)
            except RasterError as error:
                raise RasterError(f"{self.dem.path}: {error}") from error
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
            f"origin [{x:.10g}, {y:.10g}] is {away / 1000:.0f} km away from the DEM, which covers "
            f"{terrain.described()}: "
            + ("x and y are swapped, write " if swapped else "it must lie near the site, such as ")
            + wanted
        )

    def open_surface(self, ground: Dem) -> Dem:
        """What cameras see of the terrain, in the map frame: `ground` (of `open_dem`) with the tops of trees and houses
        where the site has a surface raster.
        """
        given = self.surface
        if given is None:
            return ground
        rasters = [dem.path for dem in (given, self.dem, *self.coarser)]
        way = ("surface", given.crs, self.dem.crs, *(dem.crs for dem in self.coarser), self.frame)
        return shared(rasters, way, lambda: with_surface(ground, Dem.open(given.path, given.crs).in_frame(self.frame)))

    def fuel_geometry(self, dem: Dem) -> GridGeometry:
        """The fuel grid over the DEM (given in the map frame), in the map frame, snapped in the site's CRS."""
        x, y = self.origin
        x_min, y_min, x_max, y_max = dem.geometry.bounds
        snapped = GridGeometry.snapped(
            (x_min + x, y_min + y, x_max + x, y_max + y), self.fuel.resolution, self.fuel.phase
        )
        return snapped.translated(-x, -y)

    def in_crs(self, geometry: GridGeometry) -> GridGeometry:
        """A raster of the map frame as a raster of the site's CRS, for files."""
        return geometry.translated(*self.origin, crs=self.crs)

    def in_map(self, geometry: GridGeometry) -> GridGeometry:
        """A raster of the site's CRS as a raster of the map frame."""
        x, y = self.origin
        return geometry.translated(-x, -y)

    def camera(self, name: str) -> CameraConfig:
        """Raises ConfigError naming the cameras there are."""
        if name not in self.cameras:
            raise ConfigError(f"site {self.name} has no camera {name!r}; it has {', '.join(self.cameras)}")
        return self.cameras[name]
