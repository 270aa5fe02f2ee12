"""`ltm upgrade` and `ltm rollback`: change the release that an installed tower runs."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ltm_ros.tower.upgrade import Upgrade

READY_MINUTES = 2.0
"""Kernels are compiled before, so a good release starts in seconds; a tower shall not stand still for longer than
three minutes, and the former release needs some of them."""


def upgrade(
    package: Annotated[Path, typer.Argument(help="Debian package of a release (`make deb`).")],
    ready_minutes: Annotated[
        float, typer.Option(min=0.1, help="Time in which all its nodes must be ready; else the former release returns.")
    ] = READY_MINUTES,
) -> None:
    """Run another release of LTM; where it does not come up, the former one returns by itself. As root.

    The new release is asked first (`ltm doctor`, `ltm check`, its kernels), while the former one works. The stores are
    copied before it is started.
    """
    import os
    import subprocess  # nosec B404 # argument lists, no shell

    from ltm_ros.tower.releases import PackageFile

    change = _upgrade(ready_minutes)
    opened = PackageFile.open(package)
    change.install(opened)
    # Now dpkg is told, and takes over its files: the service runs them already.
    ran = subprocess.run(  # nosec B603 B607 # no shell; root's own PATH
        ["dpkg", "--install", str(opened.path)], env=os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
    )
    if ran.returncode:
        typer.echo("-- dpkg did not take it: `dpkg --configure ltm` says why; the release runs all the same", err=True)
        raise typer.Exit(1)


def rollback(
    to: Annotated[str, typer.Option(help="Version to return to. Default: the former one.")] = "",
    unconfirmed: Annotated[
        bool,
        typer.Option("--unconfirmed", help="Only where an upgrade was cut short; the service's own start asks for it."),
    ] = False,
    ready_minutes: Annotated[float, typer.Option(min=0.1, help="Time in which it must be ready.")] = READY_MINUTES,
) -> None:
    """Run the former release of LTM again. As root."""
    change = _upgrade(ready_minutes)
    if unconfirmed:
        returned = change.return_unconfirmed()
        typer.echo(f"-- back on {returned}: the release on trial had not come up" if returned else "-- nothing to do")
        return
    change.go_back(to)


def _upgrade(ready_minutes: float) -> Upgrade:
    import os
    import signal

    from ltm_core.base.errors import ConfigError
    from ltm_ros.tower.releases import ROOT, Releases
    from ltm_ros.tower.service import SystemdService
    from ltm_ros.tower.upgrade import Places, Upgrade

    releases = Releases()
    _ = releases.current  # first: that this is an installed tower at all
    if os.geteuid() != 0 or not os.access(ROOT, os.W_OK):
        raise ConfigError("releases are changed by root: sudo ltm upgrade ...")
    # A radio link that drops takes the shell with it, and its terminal: the change goes on, or back, to its end.
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    return Upgrade(releases, SystemdService(), Places(), _say, ready_minutes * 60.0)


def _say(line: str) -> None:
    with contextlib.suppress(OSError):
        typer.echo(f"-- {line}")
