"""`ltm status`: how a running tower is, for a person."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

INSTALLED_SITE = Path("/etc/ltm/site.yaml")
LARGEST = 16 << 20


def status(
    site: Annotated[Path, typer.Argument(help="Site file (YAML), with the section `health`.")] = INSTALLED_SITE,
    json_: Annotated[bool, typer.Option("--json", help="Print what the tower says as JSON.")] = False,
) -> None:
    """Ask a running tower how it is. Exit code 0 where all nodes report and all frames come, else 1."""
    import json

    from ltm_core.base.errors import ConfigError
    from ltm_core.site.site_io import load_site
    from ltm_ros.tower.health_client import ask
    from ltm_ros.tower.status_table import print_status

    config = load_site(site).health
    if config is None:
        raise ConfigError(f"{site}: has no section `health`; add `health: {{}}`, and start the tower again")
    said: dict[str, Any] = ask(config, "/status.json")
    if json_:
        typer.echo(json.dumps(said, indent=2))
    else:
        print_status(said)
    raise typer.Exit(0 if said["ready"] else 1)
