"""The sections of a site file, one typed class each: what a site states of its rasters, cameras, limits and nodes."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from ltm_core.base.strict_model import StrictModel
from ltm_core.cameras.camera_config import CalibrationConfig, PoseConfig
from ltm_core.cameras.sensor_pose import SensorsConfig
from ltm_core.fuel.change_regions import FusionRules
from ltm_core.fuel.life_form import GrowthLimits
from ltm_core.fuel.prior import PriorConfig
from ltm_core.pose_estimation.mount.mount_config import MountConfig
from ltm_core.site.source_config import NetworkSettings, PtzConfig, SnapshotConfig, SourceConfig
from ltm_core.vision.manifest import SHIPPED_LABEL_HEAD
from ltm_core.vision.masks import MOST_VIEW_MASKS, MaskConfig, ViewMask


class DemConfig(StrictModel):
    path: Path
    """Raster file, relative to the site file."""
    crs: str | None = None
    """Only for a raster that carries none."""


class FuelConfig(StrictModel):
    resolution: float = Field(30.0, gt=0)
    """Cell size, metres; LANDFIRE's is 30."""
    phase: float = 15.0
    """Cell edges lie at phase mod resolution in the site's CRS; LANDFIRE's at 15 mod 30."""
    max_range: float = Field(6000.0, gt=0)
    """Metres beyond which a pixel's footprint is too coarse to vote for a cell."""
    growth: GrowthLimits = GrowthLimits()
    """Where the terrain says that no plant stands, so that none there votes."""
    prior: PriorConfig | None = None
    """The fuel map that evidence starts from; None: nothing is known before it is seen."""
    climate: str = "dry"
    """Name of a file in config/fuel/climates, which holds the fuel models that changed cells get."""
    fusion: FusionRules = FusionRules()
    """How evidence is weighed and when a cell changes."""
    label_errors: str | None = None
    """What the network takes for what, and how its errors correlate: a YAML file; None: its calibration."""


class MessageLimits(StrictModel):
    """How large messages may be; what is larger is dropped, and counted as `too_large`, before anything is made of it.

    So that each node stays below a gigabyte at the bound (`test_memory_at_limits.py`).
    """

    image_bytes: int = Field(32 << 20, ge=1)
    """Size of a compressed image."""
    pixels: int = Field(12_600_000, ge=1)
    """Number in an image and in a calibration: the depth of a pixel takes 44 bytes while it is traced."""
    waiting_bytes: int = Field(128 << 20, ge=1)
    """Size of the image data that waits in a node for the other messages of its frame."""


class WatchdogConfig(StrictModel):
    """When the runner takes a node for hung, kills it and starts it again. Seconds in which both run."""

    silent: float = Field(8.0, ge=2)
    """Without a sign of life, while it neither computes nor waits for a core or a disk: stopped, or deadlocked with
    Python's lock in hand."""
    stuck: float = Field(120.0, ge=2)
    """On one message, or in one callback of its executor."""
    deaf: float = Field(120.0, ge=2)
    """Without a message of any topic, while other processes of the graph send ten or more on topics that it listens to.
    After each run in a row that heard nothing, the next has twice as long."""
    slow: float = Field(600.0, ge=2)
    """For what may take long: the start (kernels are compiled, the DEM is read), what a service was asked for, the end.
    After each start in a row that was too slow, the next has twice as long."""


class CameraConfig(StrictModel):
    image: Literal["compressed", "raw"] = "compressed"
    """`image_raw/compressed` (JPEG or PNG) or `image_raw`."""
    calibration: CalibrationConfig | None = None
    """None: from the camera_info topic."""
    pose: PoseConfig | None = None
    """None: from the pose topic."""
    sensors: SensorsConfig | None = None
    """Instead of the pose topic: from the topics `fix` (NavSatFix) and `imu` (Imu)."""
    mask: MaskConfig | None = None
    """What of a camera's pictures never shows the landscape: a PNG in the site file's folder, or polygons; see
    `ltm mask`. None: nothing of them."""
    view_masks: tuple[ViewMask, ...] = Field((), max_length=MOST_VIEW_MASKS)
    """Of a turning camera: what hides the landscape besides, where it looks one way. A picture that looks nowhere near
    any of them has `mask` alone."""
    label_head: str = SHIPPED_LABEL_HEAD
    """Label head of the segmentation network for what this camera sees: `landscape` is the network's own, others are
    taught (`ltm train head`); a name, or a path from the site's folder of label heads."""
    mount: MountConfig | None = None
    """Of a PTZ head: what makes poses, and where it zooms calibrations, of what its encoders say."""
    ptz: PtzConfig | None = None
    """How the PTZ head is asked where it looks, and which presets it is driven to; needs `mount`."""
    source: SourceConfig | None = None
    """Where given, the node `source` asks the camera for its pictures and publishes them; None: a driver does."""
    judge_pictures: bool = True
    """Tell pictures by night, in fog or glare, blank or blurred ones from usable ones; they do not vote, move the
    terrain or fit the pose."""
    judge_smoke: bool = True
    """Of judged pictures: tell smoke before the land, which does not vote, by earlier pictures. False: each picture is
    judged by itself alone, as in an archive, whose map is then that of the recording replayed."""

    @model_validator(mode="after")
    def _one_pose(self) -> Self:
        given = [name for name in ("pose", "sensors", "mount") if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(
                f"give either {' or '.join(given)}, not both: a camera is fixed (pose), turns on a PTZ head (mount), "
                "or has sensors for its pose (sensors)"
            )
        if self.mount is not None and self.mount.lens is not None and self.calibration is not None:
            raise ValueError("give either calibration (fixed lens) or mount.lens (zoom), not both")
        return self

    @model_validator(mode="after")
    def _views_turn(self) -> Self:
        if self.view_masks and self.pose is not None:
            raise ValueError("view_masks are for a camera that turns; for a camera with a pose write `mask`")
        names = [view.name for view in self.view_masks]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"view_masks: {', '.join(twice)} is repeated; give each view its own name")
        return self

    @model_validator(mode="after")
    def _ptz_needs(self) -> Self:
        if self.ptz is None:
            return self
        if self.mount is None:
            raise ValueError("ptz needs mount, which converts the readings of the PTZ head to a pose")
        if self.source is None:
            raise ValueError("ptz needs source: the PTZ head is queried before and after each image")
        if self.ptz.patrol is not None and not isinstance(self.source, SnapshotConfig):
            raise ValueError(
                f"a patrol needs a source of kind snapshot, which is read at each preset, not {self.source.kind}"
            )
        if self.ptz.url is None and not isinstance(self.source, NetworkSettings):
            raise ValueError(
                f"a source of kind {self.source.kind} has no address: give the address of the PTZ head as ptz.url"
            )
        return self

    @model_validator(mode="after")
    def _source_needs(self) -> Self:
        if self.source is None:
            return self
        if self.calibration is None and (self.mount is None or self.mount.lens is None):
            raise ValueError("a camera with a source needs its calibration here: width, height and hfov_deg or fx")
        if self.image == "raw" and self.source.kind not in ("rtsp", "v4l2"):
            raise ValueError(f"a source of kind {self.source.kind} publishes the camera's JPEGs: leave image out")
        return self


class HealthConfig(StrictModel):
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
                f"address {self.address} is reachable from other hosts: give certificate, key and token, or 127.0.0.1"
            )
        return self
