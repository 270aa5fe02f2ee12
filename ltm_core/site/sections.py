"""Sections of a site file, one typed class each: rasters, cameras, limits and nodes."""

import ipaddress
from pathlib import Path
from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

from pydantic import Field, ValidationInfo, field_validator, model_validator

from ltm_core.base.redaction import is_loopback, url_without_secrets
from ltm_core.base.strict_model import Expert, StrictModel, Written
from ltm_core.cameras.camera_config import CalibrationConfig, PoseConfig
from ltm_core.cameras.sensor_pose import SensorsConfig
from ltm_core.fuel.prior import PriorConfig
from ltm_core.fuel.rules import FusionRules
from ltm_core.pose_estimation.mount.mount_config import MountConfig
from ltm_core.site.source_config import (
    LoginSettings,
    NetworkSettings,
    PtzConfig,
    SecretConfig,
    SourceConfig,
)
from ltm_core.vision.manifest import SHIPPED_LABEL_HEAD
from ltm_core.vision.mask_config import MOST_VIEW_MASKS, MaskConfig, ViewMask


class DemConfig(StrictModel):
    path: Path
    """Path of the raster file, relative to the site file."""
    crs: Written[str | None] = None
    """CRS of a raster that does not state one."""


class FuelConfig(StrictModel):
    resolution: float = Field(30.0, gt=0)
    """Cell size in metres; LANDFIRE uses 30."""
    phase: float = 15.0
    """Offset of the cell edges in metres, modulo `resolution` in the site's CRS (LANDFIRE: 15 modulo 30)."""
    max_range: Expert[float] = Field(6000.0, gt=0)
    """Range in metres beyond which a pixel does not vote, because its footprint is too coarse."""
    steepest_deg: Expert[float | None] = Field(50.0, gt=0, lt=90)
    """Slope in degrees over the width of a fuel cell above which labels of grass, shrub and tree are ignored. Of
    LANDFIRE's vegetated cells in the Santa Ana Mountains 0.4, 0.5 and 1.2 % are steeper, near the Tubbs fire at most
    0.2 %, in Vermont none (docs/how/fuel.md)."""
    prior: PriorConfig | None = None
    """Fuel map that evidence starts from; None: nothing is known before it is seen."""
    climate: str = "dry"
    """Name of a file in config/fuel/climates with the fuel models that changed cells get."""
    fusion: Expert[FusionRules] = FusionRules()
    """Rules for weighting evidence and changing cells."""
    label_errors: Expert[str | None] = None
    """Path of a YAML file with the network's label confusion and its correlations; None: the network's calibration."""


class MessageLimits(StrictModel):
    """Maximum size of messages; larger ones are dropped and counted as `too_large` before they are processed.

    So that each node stays below a gigabyte at the bound (`test_memory_at_limits.py`)."""

    image_bytes: int = Field(32 << 20, ge=1)
    """Maximum size of a compressed image in bytes."""
    pixels: int = Field(12_600_000, ge=1)
    """Maximum number of pixels in an image or calibration; tracing needs 44 bytes per pixel."""
    waiting_bytes: int = Field(128 << 20, ge=1)
    """Maximum size in bytes of the image data that a node holds while it waits for the other messages of a frame."""


class WatchdogConfig(StrictModel):
    """Criteria of the watchdog for restarting a process. Times in seconds."""

    silent: float = Field(8.0, ge=2)
    """Seconds without a heartbeat after which a process is restarted, if it neither computes nor waits for a core or a
    disk (stopped, or deadlocked while it holds Python's lock)."""
    stuck: float = Field(120.0, ge=2)
    """Seconds on one message, or in one executor callback, after which a process is restarted."""
    slow: float = Field(600.0, ge=2)
    """Seconds allowed for slow operations: start (compiling kernels, reading the DEM), service calls and shutdown. The
    limit doubles after each consecutive start that was too slow."""


TopicName = Annotated[str, Field(pattern=r"^(/[A-Za-z_][A-Za-z0-9_]*)+$")]


class TopicsConfig(StrictModel):
    """Absolute names of a camera's input topics, live and in recordings, instead of `/<site>/<camera>/...`."""

    image: TopicName | None = None
    """Topic in place of `image_raw/compressed` or `image_raw`."""
    camera_info: TopicName | None = None
    """Topic in place of `camera_info` (CameraInfo)."""
    pose: TopicName | None = None
    """Topic in place of `pose`."""
    fix: Expert[TopicName | None] = None
    """Topic in place of `fix` (NavSatFix)."""
    imu: Expert[TopicName | None] = None
    """Topic in place of `imu` (Imu)."""


class CameraConfig(StrictModel):
    image: Literal["auto", "compressed", "raw"] = "auto"
    """Image topic: `compressed`: `image_raw/compressed` (JPEG or PNG); `raw`: `image_raw`; `auto`: what there is."""
    topics: TopicsConfig = TopicsConfig()
    """Names of the camera's input topics, if they are not `/<site>/<camera>/...`."""
    calibration: CalibrationConfig | None = None
    """Calibration of the camera; None: the topic camera_info."""
    pose: PoseConfig | None = None
    """Pose of a fixed camera; None: the topic pose."""
    sensors: SensorsConfig | None = None
    """Sensors that give the pose instead of the pose topic: the topics `fix` (NavSatFix) and `imu` (Imu)."""
    mask: MaskConfig | None = None
    """Parts of the image that never show the landscape: a PNG beside the site file, or polygons (`ltm mask`)."""
    view_masks: Written[tuple[ViewMask, ...]] = Field((), max_length=MOST_VIEW_MASKS)
    """Additional masks of a turning camera, each for one viewing direction; other images have only `mask`."""
    label_head: str = SHIPPED_LABEL_HEAD
    """Label head of the segmentation network for this camera: `landscape` is the network's own; others are trained
    (`ltm train head`). Give a name, or a path relative to the site's folder of label heads."""
    mount: MountConfig | None = None
    """Mount of a PTZ camera, which converts encoder readings to poses and, with zoom, to calibrations."""
    ptz: PtzConfig | None = None
    """Connection to the PTZ head and the presets it is driven to; needs `mount`."""
    source: SourceConfig | None = None
    """Camera that the node `source` reads and publishes; None: a driver publishes the images."""
    judge_pictures: Expert[bool] = True
    """Whether to classify images as usable, or as night, fog, glare, blank or blurred. Unusable images do not vote,
    change the terrain or fit the pose."""
    judge_smoke: Expert[bool] = True
    """Whether to detect smoke in front of the land in judged images by comparison with earlier ones; smoke does not
    vote. False: each image is judged alone, so that an archive and a replay give the same map."""

    @model_validator(mode="after")
    def _sections_agree(self) -> Self:
        given = [name for name in ("pose", "sensors", "mount") if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(
                f"give either {' or '.join(given)}, not both: a camera is fixed (pose), turns on a PTZ head (mount), "
                "or has sensors for its pose (sensors)"
            )
        lens = None if self.mount is None else self.mount.lens
        if lens is not None and self.calibration is not None:
            raise ValueError("give either calibration (fixed lens) or mount.lens (zoom), not both")
        if self.view_masks and self.pose is not None:
            raise ValueError("view_masks are for a camera that turns; for a camera with a pose write `mask`")
        names = [view.name for view in self.view_masks]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"view_masks: {', '.join(twice)} is repeated; give each view its own name")
        source = self.source
        if self.ptz is not None:
            if self.mount is None:
                raise ValueError("ptz needs mount, which converts the readings of the PTZ head to a pose")
            if source is None:
                raise ValueError("ptz needs source: the PTZ head is queried before and after each image")
            if self.ptz.url is None and not isinstance(source, NetworkSettings):
                raise ValueError(
                    f"a source of kind {source.kind} has no address: give the address of the PTZ head as ptz.url"
                )
        if source is not None:
            if self.calibration is None and lens is None:
                raise ValueError("a camera with a source needs its calibration here: width, height and hfov_deg or fx")
            if self.topics != TopicsConfig():
                raise ValueError("a camera with a source publishes on its own topics: leave topics out")
            if self.image == "raw" and source.kind != "rtsp":
                raise ValueError(f"a source of kind {source.kind} publishes the camera's JPEGs: leave image out")
        return self


class HealthConfig(StrictModel):
    """HTTP endpoint of a tower for monitoring systems; a site with this section runs the node `health`."""

    port: int = Field(9464, ge=0, le=65535)
    """TCP port; 0: any free port."""
    address: str = "127.0.0.1"
    """IP address to listen on. Any address other than loopback needs `certificate`, `key` and `token`."""
    certificate: Path | None = None
    """Path of the certificate chain (PEM), relative to the site file."""
    key: Path | None = None
    """Path of the private key (PEM). A systemd credential with the file's name takes precedence."""
    token: Path | None = None
    """File with the token of clients (`Authorization: Bearer`). A systemd credential of its name takes precedence."""
    frame_age: Expert[float] = Field(120.0, gt=0)
    """Age of the newest frame in seconds above which a camera is not ready."""

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


class AlertsConfig(LoginSettings):
    """Receivers of a JSON message for each change of state of a camera, pose, node, disk, clock or outbox."""

    webhook: str | None = None
    """URL (http, https) that receives each message by POST; `{token}` in it is replaced."""
    token: SecretConfig | None = None
    """Place of the webhook's token; it is sent as `Authorization: Bearer`, or in the URL in place of `{token}`."""
    mqtt: str | None = None
    """URL of an MQTT 5 broker, `mqtts://HOST:PORT`; messages go to the topic `ltm/SITE/alerts`. `mqtt://` is without
    TLS, and only for a broker on this computer."""
    ca: Expert[Path | None] = None
    """Certificate of the broker's authority (PEM), relative to the site file; None: the system's authorities."""
    certificate: Expert[Path | None] = None
    """Certificate for the broker (PEM), relative to the site file; None: none is sent."""
    key: Expert[Path | None] = None
    """Private key (PEM) of `certificate`. A systemd credential with the file's name takes precedence."""

    @field_validator("webhook", "mqtt")
    @classmethod
    def _url(cls, url: str | None, info: ValidationInfo) -> str | None:
        if url is not None:
            schemes = ("http", "https") if info.field_name == "webhook" else ("mqtt", "mqtts")
            url_without_secrets(url.replace("{token}", "{password}"), schemes)
        return url

    @model_validator(mode="after")
    def _receiver(self) -> Self:
        if self.webhook is None and self.mqtt is None:
            raise ValueError("give webhook, mqtt or both")
        if self.token is None and "{token}" in (self.webhook or ""):
            raise ValueError("the webhook contains {token}: give token: {credential: NAME} (or environment, file)")
        if (self.certificate is None) != (self.key is None):
            raise ValueError("give certificate and key together")
        if self.mqtt is not None and self.mqtt.startswith("mqtt://"):
            host = urlsplit(self.mqtt).hostname or ""
            if not is_loopback(host):
                raise ValueError(f"mqtt: {host} is another host: use TLS, mqtts://{host}")
        return self
