"""`ltm cameras`: probe a camera, and take a snapshot with its pose."""

import os
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from typer import Argument, Option

from ltm_core.base.errors import ConfigError
from ltm_core.base.redaction import plain, redacted, url_without_secrets
from ltm_core.geometry.pose import pose_sigmas, sigma_keys
from ltm_core.site.site import Site
from ltm_core.site.site_io import dumped, load_site, stated_sections, write_camera
from ltm_core.site.source_config import SecretConfig
from ltm_core.storage.disk_io import require_files, require_folder
from ltm_core.tracing.trace_io import write_pose_file
from ltm_msgs_py.image import encode_rgb
from ltm_ros.cameras.camera_source import Frame
from ltm_ros.cameras.opening import source_of
from ltm_ros.cameras.probe import PLACE, Found, completed, lacking, site_entry
from ltm_ros.cameras.probe import probe as ask
from ltm_ros.cameras.protocols.credentials import SourceError, UnauthorisedError
from ltm_ros.cli.output import Overwrite, Row, command_group, numbers, print_table, say, warn, working
from ltm_ros.runtime.health import Health

PROMPTED = "LTM_CAMERA_PASSWORD"
"""Environment variable of this process that holds a password typed at the prompt."""

CREDENTIALS = Path("/etc/ltm/credentials")
"""Folder whose files systemd passes to an installed tower; a site file names them as credentials."""

READINGS = "readings.csv"

cameras = command_group("Probe a camera for the site file, and take snapshots.")


@cameras.command()
def probe(
    url: Annotated[str, Argument(help="Address (http://, https:// or rtsp://); without a path, the camera's host.")],
    user: Annotated[str | None, Option(help="User name; the password is prompted for unless given below.")] = None,
    password_env: Annotated[str | None, Option(help="Environment variable that holds the password.")] = None,
    password_file: Annotated[Path | None, Option(help="File that holds only the password.")] = None,
    ca: Annotated[Path | None, Option(help="CA certificates (PEM) for https. Default: the system's.")] = None,
    check_name: Annotated[bool, Option("--check-name/--any-name", help="Check the host of the certificate.")] = True,
    site: Annotated[Path | None, Option(help="With --camera: add or complete it in this site file.")] = None,
    camera: Annotated[str, Option(help="Name of the camera in the site file.")] = "",
    lonlat: Annotated[str | None, Option(help="Camera position LON,LAT in degrees (WGS 84).")] = None,
    height: Annotated[float | None, Option(help="Height above the ground in metres.")] = None,
    azimuth: Annotated[float | None, Option(help="Azimuth in degrees from grid north (PTZ: at pan 0).")] = None,
    pitch: Annotated[float, Option(help="Pitch in degrees above the horizon (fixed cameras only).")] = 0.0,
    hfov: Annotated[float | None, Option(help="Horizontal field of view in degrees.")] = None,
    replace: Annotated[bool, Option("--replace", help="Overwrite sections that the camera has there.")] = False,
    timeout: Annotated[float, Option(min=0.1, max=60, help="Timeout of each request in seconds.")] = 5.0,
) -> None:
    """Probe a camera: protocol, image size, rate, clock and PTZ head; print its site-file entry."""
    if (site is None) != (not camera):
        raise ConfigError("give --site and --camera together: the site file to write and the camera's name in it")
    present = {} if site is None else stated_sections(site, camera)
    lon, lat = (None, None) if lonlat is None else numbers(lonlat, "--lonlat", (2,))
    address = _checked_address(url)
    secret, kept = _secret(user, password_env, password_file, camera)
    with working("requesting") as status:

        def show(what: str) -> None:
            status.update(f"requesting {escape(plain(what))}")

        try:
            found = ask(address, user, secret, ca, check_name, timeout, show)
        except UnauthorisedError as error:
            raise UnauthorisedError(
                f"{error}. Probing stopped here, because cameras lock an account after a few wrong passwords"
            ) from None
    _print_found(found)
    if found.source is None and found.ptz is None:
        raise ConfigError(
            f"{address}: found neither an image nor a PTZ head:\n" + "\n".join(f"  {w}: {t}" for w, t in found.tried)
        )
    stated = dict(zip((*PLACE, "pitch_deg", "hfov_deg"), (lon, lat, height, azimuth, pitch, hfov), strict=True))
    entry = completed(present, site_entry(found, user, kept, stated))
    missing = lacking({**present, **entry})
    typer.echo(dumped({"cameras": {camera or "north": entry}}).rstrip())
    for what in missing:
        warn(f"still to be added: {what}")
    if kept is not None and kept.environment == _variable(camera):
        say(f"set the password in the environment of `ltm run`: export {kept.environment}=...")
    if site is None:
        return
    if missing:
        raise ConfigError(f"{site} was not changed: camera {camera} lacks {'; '.join(missing)}")
    write_camera(site, camera, entry, replace)
    typer.echo(f"wrote camera {camera} into {site}\nnext: ltm check {site}")


@cameras.command()
def snapshot(
    site: Annotated[Path, Argument(help="Site file.")],
    camera: Annotated[str, Argument(help="Name of a camera with a section `source`.")],
    out: Annotated[Path, Option("--out", "-o", help="Folder for the image and its pose file.")],
    name: Annotated[str, Option(help="Base name of the files. Default: camera and time.")] = "",
    tries: Annotated[int, Option(min=1, max=100, help="Number of images that may be rejected before giving up.")] = 5,
    overwrite: Overwrite = False,
) -> None:
    """Take an image now, with its pose. For a PTZ head, add its reading to readings.csv for `ltm pose mount`."""
    from ltm_core.pose_estimation.mount.mount_io import append_reading  # here, because help and `probe` do not need it

    loaded = load_site(site)
    require_folder(out, "an image")
    with working(f"requesting an image from {camera}"):
        frame = _frame(loaded, camera, tries)
    taken = datetime.fromtimestamp(frame.stamp_ns / 1e9, UTC)
    stem = name or f"{camera}_{taken:%Y%m%dT%H%M%SZ}"
    files = [out / f"{stem}.jpg"] + ([] if frame.pose is None else [out / f"{stem}.yaml"])
    require_files(files, overwrite)
    out.mkdir(parents=True, exist_ok=True)
    files[0].write_bytes(frame.jpeg or b"" if frame.rgb is None else encode_rgb(frame.rgb, "jpeg", 95))
    say(f"taken {taken:%Y-%m-%d %H:%M:%S} UTC +- {frame.uncertainty:.2f} s, by {frame.told_by}")
    if (reading := frame.reading) is not None:
        say(f"PTZ head: pan {reading.pan_deg:.3f}, tilt {reading.tilt_deg:.3f}, zoom {reading.zoom:g}")
        files.append(out / READINGS)
        append_reading(files[-1], files[0].name, reading.pan_deg, reading.tilt_deg, reading.zoom)
    if frame.pose is None:
        say("the site file has no pose for this camera, so the image cannot be traced")
    else:
        azimuth, pitch, roll = frame.pose.angles_deg
        line = f"viewing direction: azimuth {azimuth:.2f}, pitch {pitch:+.2f}, roll {roll:+.2f} deg"
        sigmas = {}
        if frame.covariance is not None:
            sigmas = sigma_keys(frame.pose, frame.covariance)
            angles = pose_sigmas(frame.pose, frame.covariance)[3:]
            line += f" (sigmas {', '.join(f'{sigma:.2f}' for sigma in angles)})"
        say(f"{line}; field of view {frame.camera.hfov_deg:.1f} deg")
        note = f"Image of {camera} at {taken:%Y-%m-%dT%H:%M:%SZ}, by `ltm cameras snapshot`."
        rays = loaded.curvature, loaded.refraction
        write_pose_file(files[1], frame.camera, frame.pose, sigmas, rays, loaded.frame, [note])
    for path in files:
        say(f"  {path}")


def _frame(site: Site, name: str, tries: int) -> Frame:
    """Return the first usable image of a camera. Raises ConfigError, and SourceError with the reason."""
    camera = site.camera(name)
    if camera.source is None:
        raise ConfigError(
            f"camera {name} of site {site.name} has no section `source`, so no image can be requested from it"
        )
    frames = list[Frame]()
    settings = camera.source.model_copy(update={"night": "publish"})  # a snapshot at night is accepted, too
    source = source_of(site, name, settings, frames.append, Health())
    try:
        for _ in range(tries):
            pause = source.step()
            if frames:
                return frames[0]
            if source.record.latest in ("unauthorised", "stalled"):
                break
            time.sleep(min(pause, 1.0))
        raise SourceError(f"{name} sent no usable image: {source.record.latest}: {source.record.why}")
    finally:
        source.close()


def _checked_address(url: str) -> str:
    """Return the checked address. Raises ConfigError if it is invalid or contains a password."""
    if "://" not in url:
        url = f"http://{url}"
    try:
        return url_without_secrets(url, ("http", "https", "rtsp", "rtsps"))
    except ValueError as error:
        how = ". Give --user NAME and --password-env or --password-file, or type the password at the prompt"
        raise ConfigError(f"{redacted(url)}: {error}{'' if redacted(url) == url else how}") from None


def _variable(camera: str) -> str:
    return f"LTM_{(camera or 'north').upper()}_PASSWORD"


def _secret(
    user: str | None, password_env: str | None, password_file: Path | None, camera: str
) -> tuple[SecretConfig | None, SecretConfig | None]:
    """Return where the password is now, and where the site file should read it from."""
    if password_env is not None and password_file is not None:
        raise ConfigError("give --password-env or --password-file, not both")
    if user is None:
        if password_env is not None or password_file is not None:
            raise ConfigError("a password needs --user")
        return None, None
    if password_env is not None:
        secret = SecretConfig(environment=password_env)
        return secret, secret
    if password_file is not None:
        file = password_file.expanduser().absolute()
        secret = SecretConfig(file=file)
        return secret, SecretConfig(credential=file.name) if file.parent == CREDENTIALS else secret
    os.environ[PROMPTED] = typer.prompt(f"password of {user}", hide_input=True)
    return SecretConfig(environment=PROMPTED), SecretConfig(environment=_variable(camera))


def _print_found(found: Found) -> None:
    rows: list[Row] = []

    def row(what: str, told: str, style: str = "") -> None:
        """Add a row, without the control characters that a camera may have written."""
        rows.append(((style, plain(what)), (style, plain(told))))

    if found.source is not None:
        row("images", f"{found.source['kind']} at {found.source['url']}")
    for address in found.stated:
        row("reported address", redacted(address))
    if found.size is not None:
        each = "" if found.bytes_each is None else f", {found.bytes_each / 1000:.0f} kB each"
        row("size", f"{found.size[0]} x {found.size[1]} pixels{each}")
    for measured in found.measured.items():
        row(*measured)
    if found.ptz is not None:
        ptz, reading = found.ptz
        row("PTZ protocol", " ".join(str(value) for value in ptz.values()))
        row("pan", f"{reading.pan_deg:.2f} deg")
        row("tilt", f"{reading.tilt_deg:.2f} deg")
        row("zoom", f"{reading.zoom:g}")
    for what, told in found.tried:
        row(f"request: {what}", told, "dim")
    print_table("camera", ("what", "found"), rows)
