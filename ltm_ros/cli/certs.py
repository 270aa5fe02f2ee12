"""`ltm certs`: a small authority for trials of the link between towers and their region's map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def certs(
    folder: Annotated[Path, typer.Argument(help="Folder, made where it is missing; what is in it stays.")],
    region: Annotated[str, typer.Option(help="Name of the region.")],
    tower: Annotated[list[str] | None, typer.Option(help="Name of a tower; may be given several times.")] = None,
    follower: Annotated[
        list[str] | None, typer.Option(help="Name of somebody who follows the map; may be given several times.")
    ] = None,
    host: Annotated[
        list[str] | None, typer.Option(help="Name or address by which the broker is called. Default: this machine.")
    ] = None,
    listen: Annotated[str, typer.Option(help="Address at which the broker listens.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="TCP port of the broker.")] = 8883,
    days: Annotated[int, typer.Option(min=1, max=3650, help="For which certificates are valid.")] = 365,
) -> None:
    """Make certificates of a region's broker, map, towers and followers, and mosquitto's configuration for them.

    Whoever reads ca.key can be any tower: keep it elsewhere, and for more than a trial use an authority of your own.
    """
    from ltm_ros.region.certs import TrialAuthority

    hosts = host or ["localhost", "127.0.0.1", "::1"]
    new = TrialAuthority(folder, days).make(region, [*(tower or ()), *(follower or ())], hosts, listen, port)
    for path in new:
        typer.echo(f"wrote {path}")
    if not new:
        typer.echo(f"{folder}: nothing was missing")
