"""Probe a camera's protocols, and write its section of a site file."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from pydantic import TypeAdapter

from ltm_core.base.errors import ImageError
from ltm_core.base.redaction import redacted, url_without_secrets
from ltm_core.site.source_config import HttpSettings, MjpegConfig, PtzConfig, RtspConfig, SecretConfig
from ltm_msgs_py.image import picture_size
from ltm_ros.cameras.protocols.credentials import SourceError, UnauthorisedError
from ltm_ros.cameras.protocols.exposure import OffsetBounds
from ltm_ros.cameras.protocols.http_client import HttpClient, HttpResponse, http_time
from ltm_ros.cameras.protocols.http_pictures import MjpegReader, picture_in
from ltm_ros.cameras.protocols.picture import CameraImage, CameraReader, PtzReading
from ltm_ros.cameras.protocols.video import RtspReader
from ltm_ros.cameras.ptz.head import host_of, with_configured_host
from ltm_ros.cameras.ptz.makers import OnvifPtzHead, open_ptz

MOST_BYTES = 32 << 20
LISTENS_S = 4.0
"""Seconds for which a stream is read to count its images."""
FEW = 3
"""Number of single images that are requested."""
CLOCK = "clock ahead of ours by"

SNAPSHOT_PATHS = (
    "/axis-cgi/jpg/image.cgi",
    "/ISAPI/Streaming/channels/101/picture",
    "/cgi-bin/snapshot.cgi",
    "/snapshot.jpg",
)
"""Common snapshot paths: Axis, Hikvision, Dahua, and others."""
PTZ_KINDS: tuple[dict[str, Any], ...] = (
    {"kind": "vapix"},
    {"kind": "isapi", "units": "degrees"},
    {"kind": "isapi", "units": "tenths"},
    {"kind": "onvif"},
)


@dataclass
class Found:
    """Result of a probe. `source`: the camera's section of a site file, without user and password; `tried`: requests
    and answers, in words."""

    source: dict[str, Any] | None = None
    size: tuple[int, int] | None = None
    bytes_each: int | None = None
    measured: dict[str, str] = field(default_factory=dict)
    """Rate, response time and clock, in words."""
    ptz: tuple[dict[str, Any], PtzReading] | None = None
    """Section of the PTZ head in a site file, and its direction."""
    stated: tuple[str, ...] = ()
    """Addresses of images that the camera reports."""
    tried: list[tuple[str, str]] = field(default_factory=list)


def probe(
    url: str,
    user: str | None = None,
    password: SecretConfig | None = None,
    ca: Path | None = None,
    check_name: bool = True,
    timeout: float = 5.0,
    say: Callable[[str], None] = lambda text: None,
) -> Found:
    """Request an image at `url` or at common paths, and look for a PTZ head.

    Raises UnauthorisedError at the first rejected password, and stops: cameras lock an account after a few failures."""
    found = Found()
    login = {"user": user, "password": password, "timeout": timeout}
    web = login | {"ca": ca, "check_name": check_name}

    def attempt(what: str, ask: Callable[..., str], *given: Any) -> None:
        say(what)
        try:
            said = ask(found, *given)
        except UnauthorisedError:
            raise
        except (SourceError, ImageError) as error:
            said = str(error)
        found.tried.append((what, said))

    parts = urlsplit(url)
    if parts.scheme in ("rtsp", "rtsps"):
        base, places = f"http://{host_of(url)}", [url]
    else:
        base = f"{parts.scheme}://{parts.netloc}"
        places = [url] if parts.path not in ("", "/") else [base + path for path in SNAPSHOT_PATHS]
    for place in places:
        if found.source is None:
            attempt(place, _image_at, place, web)
    for given in PTZ_KINDS:
        if found.ptz is None:
            attempt(f"PTZ head by {' '.join(given.values())}", _ptz, given, web | {"url": base})
    for stated in found.stated:
        if found.source is None:
            attempt(redacted(stated), _stated, base, stated, web)
    if found.source is not None and str(found.source["url"]).startswith("https"):
        found.source |= {} if ca is None else {"ca": str(ca.resolve())}
        found.source |= {} if check_name else {"check_name": False}
    return found


def _stated(found: Found, base: str, stated: str, web: dict[str, Any]) -> str:
    """Request an image at an address that the camera at `base` reports, unless it is invalid or would put a password
    into the site file."""
    try:
        url = url_without_secrets(with_configured_host(stated, base), ("http", "https", "rtsp", "rtsps"))
    except ValueError as error:
        raise SourceError(f"invalid address reported by the camera: {error}") from None
    return _image_at(found, url, web)


def _image_at(found: Found, url: str, web: dict[str, Any]) -> str:
    """Read one image per request, or a stream."""
    if url.startswith("rtsp"):
        login = {key: web[key] for key in ("user", "password", "timeout")}
        told = _stream(found, RtspReader(RtspConfig(kind="rtsp", url=url, frames="all", **login)))
        found.source = {"kind": "rtsp", "url": url}
        return told
    client = HttpClient(HttpSettings(url=url, **web), most_bytes=MOST_BYTES)
    try:
        with client.stream(url) as (response, _, _):
            kind = response.headers.get("content-type", "")
        if "multipart" in kind.lower():
            told = _stream(found, MjpegReader(MjpegConfig(kind="mjpeg", url=url, **web), MOST_BYTES))
            found.source = {"kind": "mjpeg", "url": url}
            return told
        answers = [client.get(url) for _ in range(FEW)]
    finally:
        client.close()
    picture = picture_in(answers[-1])
    found.size, found.bytes_each = picture_size(picture), len(picture)
    seconds, repeated = min(answer.arrived - answer.asked for answer in answers), answers[0].body == answers[-1].body
    found.measured["response time"] = f"{seconds:.2f} s, {'the same' if repeated else 'a new'} image each time"
    _clock_of(found, answers)
    found.source = {"kind": "snapshot", "url": url}
    return f"an image of {found.size[0]} x {found.size[1]} pixels"


def _stream(found: Found, reader: CameraReader) -> str:
    """Read a stream for a while."""
    arrivals = []
    until = time.monotonic() + LISTENS_S
    try:
        while time.monotonic() < until:
            if not isinstance(picture := reader.read(), CameraImage):
                continue
            arrivals.append(picture.timing.arrived)
            if picture.rgb is not None:
                found.size = picture.rgb.shape[1], picture.rgb.shape[0]
            elif picture.jpeg is not None:
                found.size, found.bytes_each = picture_size(picture.jpeg), len(picture.jpeg)
            if picture.timing.taken is not None:
                now = time.time() - (time.monotonic() - picture.timing.arrived)
                found.measured[CLOCK] = f"{picture.timing.taken.epoch - now:+.1f} +- 0.5 s"
    finally:
        reader.close()
    if not arrivals:
        raise SourceError(f"no image within {LISTENS_S:g} s")
    if (lasted := arrivals[-1] - arrivals[0]) > 0:
        found.measured["rate"] = f"{(len(arrivals) - 1) / lasted:.1f} images per second"
    return f"{len(arrivals)} images in {LISTENS_S:g} s"


def _clock_of(found: Found, answers: list[HttpResponse]) -> None:
    """Estimate the camera's clock from all answers together, because each has only whole seconds."""
    bounds = OffsetBounds()
    for answer in answers:
        if (stated := http_time(answer.headers, "Date")) is None:
            return
        bounds.add(stated.epoch - answer.arrived, stated.epoch + stated.resolution - answer.asked, answer.arrived)
    low, high = bounds.at(answers[-1].arrived)
    ours = time.time() - time.monotonic()
    found.measured[CLOCK] = f"{(low + high) / 2 - ours:+.1f} +- {(high - low) / 2:.1f} s"


def _ptz(found: Found, given: dict[str, Any], web: dict[str, Any]) -> str:
    config: PtzConfig = TypeAdapter(PtzConfig).validate_python(given | web)
    ptz = open_ptz(config, None)
    try:
        if isinstance(ptz, OnvifPtzHead):
            if (ahead := ptz.soap.clock_ahead()) is not None:
                found.measured[CLOCK] = f"{ahead:+.1f} +- 0.5 s"
            found.stated = tuple(filter(None, ptz.picture_addresses()))
        reading = ptz.read()
    finally:
        ptz.close()
    found.ptz = given, reading
    return f"pan {reading.pan_deg:.2f}, tilt {reading.tilt_deg:.2f}, zoom {reading.zoom:g}"


SNAPSHOT_EVERY_S = 10.0
PLACE = ("lon", "lat", "height_above_ground", "azimuth_deg")


def site_entry(found: Found, user: str | None, password: SecretConfig | None, stated: dict[str, Any]) -> dict[str, Any]:
    """Return the sections source, ptz, mount or pose, and calibration, as far as known. `stated`: PLACE, pitch_deg and
    hfov_deg, which a camera cannot report itself; None: unknown."""
    entry: dict[str, Any] = {}
    if found.source is not None:
        entry["source"] = dict(found.source)
        if found.source["kind"] == "snapshot":
            entry["source"]["every"] = SNAPSHOT_EVERY_S
        if user is not None:
            entry["source"]["user"] = user
        if password is not None:
            entry["source"]["password"] = password.model_dump(mode="json", exclude_none=True)
    hfov, placed = stated["hfov_deg"], all(stated[name] is not None for name in PLACE)
    where = {name: stated[name] for name in PLACE if placed}
    size = {} if found.size is None else dict(zip(("width", "height"), found.size, strict=True))
    if found.ptz is not None:
        entry["ptz"], kind = dict(found.ptz[0]), found.ptz[0]["kind"]
        if size:
            entry["mount"] = where | ({"tilt_sign": -1} if kind == "isapi" else {})
            if kind == "vapix" and hfov is None:
                # The lens table of ALERTCalifornia's Axis cameras, until this lens is calibrated.
                entry["mount"]["lens"] = size
    elif where:
        entry["pose"] = where | {"pitch_deg": stated["pitch_deg"]}
    if size and hfov is not None:
        entry["calibration"] = size | {"hfov_deg": hfov}
    return entry


GUESSED = ("every", "lens", "tilt_sign")
"""Keys of an entry that were not measured: stated ones stay."""


def completed(present: dict[str, Any], entry: dict[str, Any]) -> dict[str, Any]:
    """Return the sections of `entry` merged with those that the camera has in the site file. A camera with a stated
    pose counts as fixed, so its PTZ head is left out."""
    fixed = "pose" in present or "sensors" in present
    merged = {}
    for name, section in entry.items():
        stated = present.get(name)
        if fixed and name in ("ptz", "mount"):
            continue
        if isinstance(stated, dict) and stated.get("kind") == section.get("kind"):
            section = {**stated, **section, **{key: stated[key] for key in GUESSED if key in stated}}
        merged[name] = section
    return merged


def lacking(entry: dict[str, Any]) -> list[str]:
    """Return what the user must add, each with its option of `ltm cameras probe`."""
    said = []
    if "source" not in entry:
        said.append("source: no image was found; give an image address")
    if "sensors" not in entry and "azimuth_deg" not in (entry.get("mount") or entry.get("pose") or {}):
        which = "mount" if "ptz" in entry else "pose"
        said.append(f"{which}: position and viewing direction (--lonlat, --height, --azimuth)")
    if "calibration" not in entry and "lens" not in entry.get("mount", {}):
        said.append("calibration: horizontal field of view, from the data sheet or measured (--hfov)")
    return said
