"""Configure how a camera is queried: the sections `source` and `ptz` of a camera in a site file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self
from urllib.parse import parse_qsl, urlsplit

from pydantic import Field, PositiveInt, field_validator, model_validator

from ltm_core.base.redaction import SECRET_KEYS
from ltm_core.base.strict_model import StrictModel


class SecretConfig(StrictModel):
    """Where a secret stands; never the secret itself. One of the three."""

    environment: str | None = Field(None, min_length=1)
    """Name of an environment variable."""
    file: Path | None = None
    """A file that holds nothing else; its last line break does not count."""
    credential: str | None = Field(None, pattern=r"[A-Za-z0-9_.-]+")
    """Name of a systemd credential (`LoadCredential=`): of a file in `/etc/ltm/credentials` on an installed tower."""

    @model_validator(mode="before")
    @classmethod
    def _not_the_secret(cls, data: object) -> object:
        if not isinstance(data, dict):
            raise ValueError(
                "a site file must not contain a password: write {environment: NAME}, {file: PATH} or "
                "{credential: NAME} (systemd), and set the password there"
            )
        return data

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if sum(place is not None for place in (self.environment, self.file, self.credential)) != 1:
            raise ValueError("give one of environment, file and credential")
        return self

    @property
    def place(self) -> str:
        """In words, for errors."""
        if self.environment is not None:
            return f"environment variable {self.environment}"
        return f"systemd credential {self.credential}" if self.file is None else f"file {self.file}"


class SourceSettings(StrictModel):
    """What all kinds have. Times in seconds."""

    unsynchronised: Literal["hold", "mark", "ignore"] = "mark"
    """While this computer's clock is not synchronised: no frame is published, or frames are published and `source/info`
    says so, or nothing is made of it."""
    night: Literal["hold", "publish"] = "hold"
    """What becomes of pictures in which nothing is to be seen for the dark, or without colour (infrared)."""
    stalled_after: float | None = Field(None, gt=0)
    """Without a picture that can be used; None: three times `every`, and at least 30."""
    stuck_after: float | None = Field(None, gt=0)
    """With the same picture again and again; None: six times `every`, and at least 120."""

    @property
    def period(self) -> float:
        """Between two pictures; 0: as they come."""
        return float(getattr(self, "every", 0.0))

    @property
    def stall_s(self) -> float:
        return self.stalled_after or max(30.0, 3 * self.period)

    @property
    def stuck_s(self) -> float:
        return self.stuck_after or max(120.0, 6 * self.period)


def url_without_secrets(url: str, schemes: tuple[str, ...]) -> str:
    parts = urlsplit(url)
    if parts.scheme not in schemes or not parts.hostname:
        raise ValueError(f"expected a URL that begins with {' or '.join(f'{scheme}://' for scheme in schemes)}")
    if "@" in parts.netloc:
        raise ValueError(
            "a URL in a site file must not contain user and password: write them as `user: NAME` and "
            "`password: {environment: NAME}` (or file, credential)"
        )
    for name, value in parse_qsl(parts.query, keep_blank_values=True):
        if name.lower() in SECRET_KEYS and value != "{password}":
            raise ValueError(
                f"the URL's parameter {name} holds a secret: write {name}={{password}} there, and "
                "`password: {environment: NAME}` (or file, credential) beside it"
            )
    return url


class NetworkSettings(SourceSettings):
    """What kinds have that speak to a camera. In the URL `{user}` and `{password}` stand for these."""

    url: str
    user: str | None = None
    password: SecretConfig | None = None
    timeout: float = Field(10.0, gt=0, le=60)
    """For the connection, and for each part of an answer; a whole picture may take three times as long."""

    @model_validator(mode="after")
    def _both(self) -> Self:
        if self.password is not None and self.user is None:
            raise ValueError("password needs user")
        return self


class HttpSettings(NetworkSettings):
    authentication: Literal["auto", "basic", "digest"] = "auto"
    """`auto`: digest where the camera offers it, else basic."""
    ca: Path | None = None
    """Certificates (PEM) that the camera's is checked against instead of the system's: its own, or its CA's."""
    check_name: bool = True
    """Whether the certificate must be for the URL's host; cameras' own often name none."""

    @field_validator("url")
    @classmethod
    def _url(cls, url: str) -> str:
        return url_without_secrets(url, ("http", "https"))


class SnapshotConfig(HttpSettings):
    """One picture a request."""

    kind: Literal["snapshot"]
    every: float = Field(10.0, gt=0)
    oldest: float = Field(1.0, ge=0)
    """How much older than the request a picture may be, which some cameras make once a second."""


class MjpegConfig(HttpSettings):
    """An endless answer of JPEGs (multipart/x-mixed-replace)."""

    kind: Literal["mjpeg"]
    every: float = Field(0.0, ge=0)
    """0: each picture."""


class RtspConfig(NetworkSettings):
    kind: Literal["rtsp"]
    frames: Literal["all", "key"] = "key"
    """`key`: only pictures that are whole in themselves, at a tenth of the work; most cameras send one in 1 to 4 s."""
    every: float = Field(0.0, ge=0)
    """0: each of `frames`; else the first one that much later than the last."""
    transport: Literal["tcp", "udp"] = "tcp"
    clock: Literal["measured", "trusted"] = "measured"
    """`trusted`: the camera keeps its clock by NTP, as this computer does; its sender reports are taken as they are."""
    least_delay: float = Field(0.02, ge=0, le=5)
    """From an exposure to its arrival, of the fastest frame: what a clock's offset is measured with."""

    @field_validator("url")
    @classmethod
    def _url(cls, url: str) -> str:
        return url_without_secrets(url, ("rtsp", "rtsps"))


class V4l2Config(SourceSettings):
    """A USB camera at this computer, by Video4Linux."""

    kind: Literal["v4l2"]
    device: Path
    """`/dev/v4l/by-id/...` stays when another camera is plugged in; `/dev/video0` may not."""
    every: float = Field(10.0, ge=0)
    """0: each picture."""
    rate: float | None = Field(None, gt=0)
    """Pictures a second that the camera is set to; None: as it is."""
    format: str | None = Field(None, pattern=r"[a-z0-9]+")
    """What it is set to send, as FFmpeg names it: `mjpeg`, `yuyv422`. Many send large pictures fast only as `mjpeg`.
    None: as it is."""
    size: tuple[PositiveInt, PositiveInt] | None = None
    """Width and height that it is set to; None: as it is."""
    least_delay: float = Field(0.02, ge=0, le=5)
    """From an exposure to its arrival, of the fastest picture."""

    @field_validator("device")
    @classmethod
    def _device(cls, path: Path) -> Path:
        if path.parts[:2] != ("/", "dev") or ".." in path.parts:
            raise ValueError("give a device below /dev: /dev/video0, or better /dev/v4l/by-id/...")
        return path


class FolderConfig(SourceSettings):
    """A folder that a camera writes into, such as an FTP drop."""

    kind: Literal["folder"]
    path: Path
    """Relative to the site file."""
    pattern: str = "*.jpg"
    """Of the files, as in a shell; `**` stands for folders below. Nothing outside the folder is read."""
    every: float = Field(2.0, gt=0)
    """Between two looks."""
    name_time: str | None = None
    """The time in a file's name, as of strptime: `north_%Y%m%d-%H%M%S.jpg`."""
    zone: str = "UTC"
    """Time zone of names, and of EXIF that states none."""
    oldest: float = Field(600.0, gt=0)
    """Files that are older when they are first seen are left out: a recording belongs into a replay."""
    complete_within: float = Field(60.0, gt=0)
    """Time for a file to come whole."""
    upload: float = Field(10.0, ge=0)
    """From a picture to its file, at most."""
    clock: Literal["measured", "trusted"] = "measured"
    """`trusted`: the camera keeps its clock by NTP, as this computer does; names and EXIF are taken as they are."""
    delete: bool = False
    """Delete what was published or refused."""

    @field_validator("pattern")
    @classmethod
    def _below(cls, pattern: str) -> str:
        if not pattern or pattern.startswith("/") or ".." in pattern.split("/"):
            raise ValueError("a pattern must stay below the folder: no leading / and no ..")
        return pattern


class CameraListConfig(HttpSettings):
    """A network's list of cameras (JSON) with their times and directions, and a picture a camera, as ALERTCalifornia
    has them; `url` is the list's."""

    kind: Literal["camera_list"]
    id: str
    """The camera's, in the list."""
    image: str
    """URL of its picture; `{id}` stands for the camera's id."""
    every: float = Field(30.0, gt=0)
    id_key: str = "id"
    time_key: str = "last_frame_ts"
    """Epoch seconds, or milliseconds, or ISO 8601."""
    pan_key: str = "az_current"
    tilt_key: str = "tilt_current"
    zoom_key: str = "zoom_current"
    oldest: float = Field(120.0, ge=0)
    """How old a picture may be."""

    @field_validator("image")
    @classmethod
    def _image(cls, url: str) -> str:
        return url_without_secrets(url, ("http", "https"))


SourceConfig = Annotated[
    SnapshotConfig | MjpegConfig | RtspConfig | V4l2Config | FolderConfig | CameraListConfig,
    Field(discriminator="kind"),
]


Degrees = Annotated[float, Field(ge=-720, le=720)]


class PatrolConfig(StrictModel):
    """The PTZ head is driven. Nobody else may drive it then: a tour of its own, or an operator, would only fight it."""

    presets: tuple[str, ...] = Field(min_length=1)
    """Names, in their order; from one picture to the next the PTZ head goes to the next one."""
    arrive_within: float = Field(30.0, gt=0, le=60)
    """Seconds, after which it is said to be stuck."""
    settle: float = Field(1.0, ge=0, le=20)
    """Seconds that it must have stood still: after a stop the mast swings, and the lens focuses."""


class PtzSettings(StrictModel):
    """What all kinds have. What is left out of url, user and password is that of the camera's `source`."""

    url: str | None = None
    """`http://HOST` or `https://HOST`, with its port."""
    user: str | None = None
    password: SecretConfig | None = None
    authentication: Literal["auto", "basic", "digest"] = "auto"
    ca: Path | None = None
    check_name: bool = True
    timeout: float = Field(5.0, gt=0, le=60)
    tolerance_deg: float | None = Field(None, gt=0)
    """By which two readings of a PTZ head at rest may differ: their last digit. None: what is usual for the kind."""
    patrol: PatrolConfig | None = None
    """None: the PTZ head is only asked, never driven."""

    @field_validator("url")
    @classmethod
    def _url(cls, url: str | None) -> str | None:
        return None if url is None else url_without_secrets(url, ("http", "https"))

    @model_validator(mode="after")
    def _both(self) -> Self:
        if self.password is not None and self.user is None:
            raise ValueError("password needs user")
        return self


class VapixConfig(PtzSettings):
    """Axis: degrees, and zoom from 1 to 9999."""

    kind: Literal["vapix"]
    camera: int = Field(1, ge=1)
    """Of a device with several."""


class IsapiConfig(PtzSettings):
    """Hikvision and its kin."""

    kind: Literal["isapi"]
    units: Literal["tenths", "degrees"]
    """`tenths`: of a degree, in `status`, which all have; `degrees`: with decimals, in `absoluteEx`, which newer ones
    have. Zoom is ten times the magnification in the first, the magnification in the second."""
    channel: int = Field(1, ge=1)


class OnvifConfig(PtzSettings):
    """ONVIF's generic space runs from -1 to 1 in pan and tilt; what that is in degrees is the model's own."""

    kind: Literal["onvif"]
    path: str = Field("/onvif/device_service", pattern=r"/[!-~]*")
    profile: str | None = None
    """Token of the media profile; None: the first one with a head."""
    pan_range_deg: tuple[Degrees, Degrees] = (-180.0, 180.0)
    """Pan at -1 and at 1."""
    tilt_range_deg: tuple[Degrees, Degrees] = (-90.0, 90.0)

    @model_validator(mode="after")
    def _some_range(self) -> Self:
        for name in ("pan_range_deg", "tilt_range_deg"):
            first, last = getattr(self, name)
            if first == last:
                raise ValueError(f"{name} must go from a smaller to a larger angle, not {first:g} to {last:g}")
        return self


class ReolinkConfig(PtzSettings):
    """Reolink's own counts."""

    kind: Literal["reolink"]
    channel: int = Field(0, ge=0)
    pan_steps_per_deg: float = Field(10.0, gt=0)
    """Counts of `Ppos` a degree; the model's own."""
    tilt_steps_per_deg: float = Field(10.0, gt=0)


PtzConfig = Annotated[VapixConfig | IsapiConfig | OnvifConfig | ReolinkConfig, Field(discriminator="kind")]
