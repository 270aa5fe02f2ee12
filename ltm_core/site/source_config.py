"""Configure the connection to a camera: the sections `source` and `ptz` of a camera in a site file."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, field_validator, model_validator

from ltm_core.base.redaction import url_without_secrets
from ltm_core.base.strict_model import Expert, StrictModel, Written

HttpUrl = Annotated[str, AfterValidator(lambda url: url_without_secrets(url, ("http", "https")))]


class SecretConfig(StrictModel):
    """Reference to a secret (exactly one of the three), never the secret itself."""

    environment: str | None = Field(None, min_length=1)
    """Name of an environment variable."""
    file: Path | None = None
    """File that contains only the secret; a final line break is ignored."""
    credential: str | None = Field(None, pattern=r"[A-Za-z0-9_.-]+")
    """Name of a systemd credential (`LoadCredential=`); on an installed tower, of a file in `/etc/ltm/credentials`."""

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
        """Return the place of the secret for error messages."""
        if self.environment is not None:
            return f"environment variable {self.environment}"
        return f"systemd credential {self.credential}" if self.file is None else f"file {self.file}"


class LoginSettings(StrictModel):
    """User and password for a camera, a PTZ head or a broker."""

    user: str | None = None
    """User name for the camera, PTZ head or broker."""
    password: SecretConfig | None = None
    """Place of the password of `user`."""

    @model_validator(mode="after")
    def _both(self) -> Self:
        if self.password is not None and self.user is None:
            raise ValueError("password needs user")
        return self


class HttpLogin(LoginSettings):
    """How to log in to a device by HTTP, and which certificate it has."""

    authentication: Expert[Literal["auto", "basic", "digest"]] = "auto"
    """HTTP authentication; `auto`: digest if the device offers it, else basic."""
    ca: Written[Path | None] = None
    """PEM file with the certificate of the device or of its CA, used instead of the system's certificates."""
    check_name: Written[bool] = True
    """Whether the certificate must match the host of the URL; certificates of cameras often do not."""


class SourceSettings(StrictModel):
    """Settings of all kinds of sources. Times in seconds."""

    night: Expert[Literal["hold", "publish"]] = "hold"
    """What to do with images that are too dark, or that have no colour (infrared): `hold` or `publish`."""
    stalled_after: Expert[float | None] = Field(None, gt=0)
    """Seconds without a usable image until the camera counts as stalled; None: three times `every`, at least 30."""
    stuck_after: Expert[float | None] = Field(None, gt=0)
    """Seconds with the same image until the camera counts as stuck; None: six times `every`, at least 120."""

    @property
    def period(self) -> float:
        """Return the time between two images; 0: as they arrive."""
        return float(getattr(self, "every", 0.0))

    @property
    def stall_s(self) -> float:
        return self.stalled_after or max(30.0, 3 * self.period)

    @property
    def stuck_s(self) -> float:
        return self.stuck_after or max(120.0, 6 * self.period)


class NetworkSettings(SourceSettings, LoginSettings):
    """Settings of kinds with a network connection. In the URL, `{user}` and `{password}` are replaced."""

    url: str
    """Address of the image or stream, without user and password."""
    timeout: Expert[float] = Field(10.0, gt=0, le=60)
    """Timeout in seconds for the connection and each part of a response; a whole image may take three times that."""


class HttpSettings(NetworkSettings, HttpLogin):
    @field_validator("url")
    @classmethod
    def _url(cls, url: str) -> str:
        return url_without_secrets(url, ("http", "https"))


class SnapshotConfig(HttpSettings):
    """Camera that returns one image per request."""

    kind: Literal["snapshot"]
    """Way in which images arrive."""
    every: float = Field(10.0, gt=0)
    """Seconds between two images."""
    oldest: Written[float] = Field(1.0, ge=0)
    """Maximum age of an image in seconds at the time of the request; some cameras take one image per second."""


class MjpegConfig(HttpSettings):
    """Endless response of JPEGs (multipart/x-mixed-replace)."""

    kind: Literal["mjpeg"]
    every: float = Field(0.0, ge=0)
    """Minimum seconds between two images; 0: every image."""


class RtspConfig(NetworkSettings):
    kind: Literal["rtsp"]
    frames: Expert[Literal["all", "key"]] = "key"
    """Frames to decode. `key`: key frames only, at a tenth of the work; most cameras send one every 1 to 4 s."""
    every: float = Field(0.0, ge=0)
    """Minimum seconds between two frames; 0: all of `frames`."""
    transport: Expert[Literal["tcp", "udp"]] = "tcp"
    """Transport of the stream."""
    clock: Expert[Literal["measured", "trusted"]] = "measured"
    """How to date frames. `trusted`: the camera keeps its clock by NTP, so its sender reports are used; `measured`: the
    offset of its clock is measured."""
    least_delay: Expert[float] = Field(0.02, ge=0, le=5)
    """Seconds from exposure to arrival of the fastest frame, used to measure the clock's offset."""

    @field_validator("url")
    @classmethod
    def _url(cls, url: str) -> str:
        return url_without_secrets(url, ("rtsp", "rtsps"))


class FolderConfig(SourceSettings):
    """Folder into which a camera writes, such as an FTP upload."""

    kind: Literal["folder"]
    path: Path
    """Folder of the images, relative to the site file."""
    pattern: str = "*.jpg"
    """Shell pattern of the files; `**` matches subfolders. Files outside the folder are not read."""
    every: float = Field(2.0, gt=0)
    """Seconds between two scans of the folder."""
    name_time: Expert[str | None] = None
    """Format of the time in a file name, as for strptime: `north_%Y%m%d-%H%M%S.jpg`."""
    zone: Expert[str] = "UTC"
    """Time zone of file names, and of EXIF times without a zone."""
    oldest: Written[float] = Field(600.0, gt=0)
    """Maximum age in seconds of a file when it is first found; older files are ignored."""
    complete_within: Expert[float] = Field(60.0, gt=0)
    """Maximum time in seconds for a file to be complete."""
    upload: Expert[float] = Field(10.0, ge=0)
    """Maximum time in seconds from exposure to the file."""
    clock: Expert[Literal["measured", "trusted"]] = "measured"
    """How to date images. `trusted`: the camera keeps its clock by NTP, so file names and EXIF are used; `measured`:
    the offset of its clock is measured."""
    delete: Expert[bool] = False
    """Whether to delete files after they are published or rejected."""

    @field_validator("pattern")
    @classmethod
    def _below(cls, pattern: str) -> str:
        if not pattern or pattern.startswith("/") or ".." in pattern.split("/"):
            raise ValueError("a pattern must stay below the folder: no leading / and no ..")
        return pattern


class CameraListConfig(HttpSettings):
    """List of the cameras of a network (JSON) with their times and directions and an image for each, as ALERTCalifornia
    publishes it; `url` is the list's."""

    kind: Literal["camera_list"]
    id: Written[str]
    """Identifier of the camera in the list."""
    image: Written[HttpUrl]
    """URL of the image; `{id}` is replaced by the camera's identifier."""
    every: float = Field(30.0, gt=0)
    """Seconds between two requests of the list."""
    id_key: Expert[str] = "id"
    """Key of the identifier."""
    time_key: Expert[str] = "last_frame_ts"
    """Key of the image's time: epoch seconds, epoch milliseconds or ISO 8601."""
    pan_key: Expert[str] = "az_current"
    """Key of the azimuth in degrees."""
    tilt_key: Expert[str] = "tilt_current"
    """Key of the tilt in degrees."""
    zoom_key: Expert[str] = "zoom_current"
    """Key of the zoom."""
    oldest: Written[float] = Field(120.0, ge=0)
    """Maximum age of an image in seconds."""


SourceConfig = Annotated[
    SnapshotConfig | MjpegConfig | RtspConfig | FolderConfig | CameraListConfig, Field(discriminator="kind")
]
Degrees = Annotated[float, Field(ge=-720, le=720)]


class PtzSettings(HttpLogin):
    """Settings of all kinds of PTZ heads. Missing url, user and password are those of the camera's `source`."""

    url: Expert[HttpUrl | None] = None
    """Address `http://HOST` or `https://HOST`, with the port."""
    user: Expert[str | None] = None
    """User name for the PTZ head."""
    password: Expert[SecretConfig | None] = None
    """Place of the password for the PTZ head."""
    timeout: Expert[float] = Field(5.0, gt=0, le=60)
    """Timeout in seconds for each request."""
    tolerance_deg: Expert[float | None] = Field(None, gt=0)
    """Maximum difference in degrees between two readings of a PTZ head at rest; None: the usual value of the kind."""


class VapixConfig(PtzSettings):
    """Axis cameras: degrees, and zoom from 1 to 9999."""

    kind: Literal["vapix"]
    """Protocol of the PTZ head."""
    camera: Expert[int] = Field(1, ge=1)
    """Number of the camera on a device with several."""


class IsapiConfig(PtzSettings):
    """Hikvision and compatible cameras."""

    kind: Literal["isapi"]
    units: Written[Literal["tenths", "degrees"]]
    """Units of the PTZ head. `tenths`: tenths of a degree from `status`, which all have, and zoom as ten times the
    magnification; `degrees`: decimals from `absoluteEx`, which newer ones have, and zoom as the magnification."""
    channel: Expert[int] = Field(1, ge=1)
    """Number of the channel on a device with several."""


class OnvifConfig(PtzSettings):
    """ONVIF cameras. The generic space is -1 to 1 in pan and tilt; the range in degrees depends on the model."""

    kind: Literal["onvif"]
    path: Expert[str] = Field("/onvif/device_service", pattern=r"/[!-~]*")
    """Path of the device service."""
    profile: Expert[str | None] = None
    """Token of the media profile; None: the first profile with PTZ."""
    pan_range_deg: Written[tuple[Degrees, Degrees]] = (-180.0, 180.0)
    """Pan in degrees at the normalised values -1 and 1."""
    tilt_range_deg: Written[tuple[Degrees, Degrees]] = (-90.0, 90.0)
    """Tilt in degrees at the normalised values -1 and 1."""

    @model_validator(mode="after")
    def _some_range(self) -> Self:
        for name in ("pan_range_deg", "tilt_range_deg"):
            first, last = getattr(self, name)
            if first == last:
                raise ValueError(f"{name} must go from a smaller to a larger angle, not {first:g} to {last:g}")
        return self


PtzConfig = Annotated[VapixConfig | IsapiConfig | OnvifConfig, Field(discriminator="kind")]
