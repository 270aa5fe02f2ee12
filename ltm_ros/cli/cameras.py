"""`ltm cameras`: probe a camera, and take a snapshot with its pose."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_core.base.errors import ConfigError
from ltm_ros.cli.output import Overwrite, print_table

if TYPE_CHECKING:
    from rich.console import Console

    from ltm_core.site.source_config import SecretConfig
    from ltm_ros.cameras.probe import Found, Placing

PROMPTED = "LTM_CAMERA_PASSWORD"
"""Environment variable of this process that holds a password typed at the prompt."""

CREDENTIALS = Path("/etc/ltm/credentials")
"""Folder whose files systemd passes to an installed tower; a site file names them as credentials."""

cameras = typer.Typer(no_args_is_help=True, help="Probe a camera for the site file, and take snapshots.")


@cameras.command()
def probe(
    url: Annotated[
        str, typer.Argument(help="Address (http://, https:// or rtsp://); without a path, the camera's host.")
    ],
    user: Annotated[
        str | None, typer.Option(help="User name; the password is prompted for unless given below.")
    ] = None,
    password_env: Annotated[str | None, typer.Option(help="Environment variable that holds the password.")] = None,
    password_file: Annotated[Path | None, typer.Option(help="File that holds only the password.")] = None,
    ca: Annotated[Path | None, typer.Option(help="CA certificates (PEM) for https. Default: the system's.")] = None,
    check_name: Annotated[
        bool, typer.Option("--check-name/--any-name", help="Check that the certificate is for this host.")
    ] = True,
    site: Annotated[Path | None, typer.Option(help="With --camera: add or complete it in this site file.")] = None,
    camera: Annotated[str, typer.Option(help="Name of the camera in the site file.")] = "",
    lonlat: Annotated[str | None, typer.Option(help="Camera position LON,LAT in degrees (WGS 84).")] = None,
    height: Annotated[float | None, typer.Option(help="Height above the ground in metres.")] = None,
    azimuth: Annotated[float | None, typer.Option(help="Azimuth in degrees from grid north (PTZ: at pan 0).")] = None,
    pitch: Annotated[float, typer.Option(help="Pitch in degrees above the horizon (fixed cameras only).")] = 0.0,
    hfov: Annotated[float | None, typer.Option(help="Horizontal field of view in degrees.")] = None,
    replace: Annotated[
        bool, typer.Option("--replace", help="Overwrite sections that the camera has in the site file.")
    ] = False,
    timeout: Annotated[float, typer.Option(min=0.1, max=60, help="Timeout of each request in seconds.")] = 5.0,
) -> None:
    """Probe a camera: protocol, image size, rate, clock and PTZ head; print its site-file entry."""
    from rich.console import Console
    from rich.markup import escape

    from ltm_core.base.redaction import plain
    from ltm_core.site.site_io import dumped, stated_sections, write_camera
    from ltm_ros.cameras.probe import completed, lacking, site_entry
    from ltm_ros.cameras.probe import probe as ask
    from ltm_ros.cameras.protocols.credentials import UnauthorisedError

    if (site is None) != (not camera):
        raise ConfigError("give --site and --camera together: the site file to write and the camera's name in it")
    present = {} if site is None else stated_sections(site, camera)
    placing = _placing(lonlat, height, azimuth, pitch, hfov)
    address = _checked_address(url)
    secret, kept = _secret(user, password_env, password_file, camera)
    console = Console()
    with console.status("asking") as status:

        def say(what: str) -> None:
            status.update(f"requesting {escape(plain(what))}")

        try:
            found = ask(address, user, secret, ca, check_name, timeout, say)
        except UnauthorisedError as error:
            raise UnauthorisedError(
                f"{error}. Probing stopped here, because cameras lock an account after a few wrong passwords"
            ) from None
    _print_found(console, found)
    if found.source is None and found.ptz is None:
        raise ConfigError(
            f"{address}: found neither an image nor a PTZ head:\n" + "\n".join(f"  {w}: {t}" for w, t in found.tried)
        )
    entry = completed(present, site_entry(found, user, kept, placing))
    missing = lacking({**present, **entry})
    typer.echo(dumped({"cameras": {camera or "north": entry}}).rstrip())
    for what in missing:
        console.print(f"[yellow]still to be added: {escape(what)}", highlight=False)
    if kept is not None and kept.environment == _variable(camera):
        console.print(
            f"set the password in the environment of `ltm run`: export {kept.environment}=...", highlight=False
        )
    if site is None:
        return
    if missing:
        raise ConfigError(f"{site} was not changed: camera {camera} lacks {'; '.join(missing)}")
    write_camera(site, camera, entry, replace)
    typer.echo(f"wrote camera {camera} into {site}\nnext: ltm check {site}")


@cameras.command()
def snapshot(
    site: Annotated[Path, typer.Argument(help="Site file.")],
    camera: Annotated[str, typer.Argument(help="Name of a camera with a section `source`.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the image and its pose file.")],
    name: Annotated[str, typer.Option(help="Base name of the files. Default: camera and time.")] = "",
    tries: Annotated[
        int, typer.Option(min=1, max=100, help="Number of images that may be rejected before giving up.")
    ] = 5,
    overwrite: Overwrite = False,
) -> None:
    """Take an image now, with its pose. For a PTZ head, add its reading to readings.csv for `ltm pose mount`."""
    from rich.console import Console
    from rich.markup import escape

    from ltm_ros.cli.cameras_snapshot import take_snapshot

    console = Console()
    with console.status(f"requesting an image from {camera}"):
        written, told = take_snapshot(site, camera, out, name, tries, overwrite)
    for line in told:
        console.print(escape(line), highlight=False)
    for path in written:
        console.print(escape(f"  {path}"), highlight=False)


def _checked_address(url: str) -> str:
    """Return the checked address. Raises ConfigError if it is invalid or contains a password."""
    from ltm_core.base.redaction import redacted, url_without_secrets

    if "://" not in url:
        url = f"http://{url}"
    try:
        return url_without_secrets(url, ("http", "https", "rtsp", "rtsps"))
    except ValueError as error:
        raise ConfigError(
            f"{redacted(url)}: {error}. Give --user NAME and --password-env or --password-file, or type the "
            "password at the prompt"
        ) from None


def _variable(camera: str) -> str:
    return f"LTM_{(camera or 'north').upper()}_PASSWORD"


def _secret(
    user: str | None, password_env: str | None, password_file: Path | None, camera: str
) -> tuple[SecretConfig | None, SecretConfig | None]:
    """Return where the password is now, and where the site file should read it from."""
    from ltm_core.site.source_config import SecretConfig

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


def _placing(
    lonlat: str | None, height: float | None, azimuth: float | None, pitch: float, hfov: float | None
) -> Placing:
    from ltm_ros.cameras.probe import Placing

    lon = lat = None
    if lonlat is not None:
        try:
            lon, lat = (float(part) for part in lonlat.split(","))
        except ValueError:
            raise ConfigError(f"--lonlat {lonlat}: give two numbers separated by a comma, LON,LAT") from None
    return Placing(lon, lat, height, azimuth, pitch, hfov)


def _print_found(console: Console, found: Found) -> None:
    from rich.markup import escape

    from ltm_core.base.redaction import plain, redacted

    rows: list[tuple[str, str]] = []

    def row(what: str, told: str) -> None:
        """Add a row. Escapes text that cameras wrote, and removes a password from an address."""
        rows.append((what, escape(plain(told))))

    if found.source is not None:
        row("images", f"{found.source['kind']} at {found.source['url']}")
    for address in found.stated:
        row("reported address", redacted(address))
    if found.size is not None:
        each = "" if found.bytes_each is None else f", {found.bytes_each / 1000:.0f} kB each"
        rows.append(("size", f"{found.size[0]} x {found.size[1]} pixels{each}"))
    if found.rate_hz is not None:
        rows.append(("rate", f"{found.rate_hz:.1f} images per second"))
    if found.seconds_each is not None:
        fresh = "a new image each time" if found.fresh else "[yellow]the same image each time"
        rows.append(("response time", f"{found.seconds_each:.2f} s, {fresh}"))
    if found.clock_ahead_s is not None:
        known = f" +- {found.clock_known_to_s:.1f} s" if found.clock_known_to_s is not None else ""
        rows.append(("clock ahead of ours by", f"{found.clock_ahead_s:+.1f}{known}"))
    if found.ptz is not None:
        reading = found.ptz.reading
        row("PTZ protocol", " ".join(str(value) for value in found.ptz.config.values()))
        rows.append(("pan", f"{reading.pan_deg:.2f} deg"))
        rows.append(("tilt", f"{reading.tilt_deg:.2f} deg"))
        rows.append(("zoom", f"{reading.zoom:g}"))
    for what, told in found.tried:
        rows.append((f"[dim]request: {escape(plain(what))}", f"[dim]{escape(plain(told))}"))
    print_table(console, "camera", ("what", "found"), rows)
