"""The command `ltm`. Commands import what they need when they run, so that `ltm --help` is quick."""

from __future__ import annotations

import errno
import os
import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ltm_core.base.errors import LtmError
from ltm_ros.cli.cameras import cameras
from ltm_ros.cli.check import check
from ltm_ros.cli.demo import demo
from ltm_ros.cli.export import export
from ltm_ros.cli.fire import fire
from ltm_ros.cli.import_ import import_
from ltm_ros.cli.locate import locate
from ltm_ros.cli.mask import label, mask
from ltm_ros.cli.models import models
from ltm_ros.cli.pose_mount import mount
from ltm_ros.cli.pose_photo import photo
from ltm_ros.cli.pose_points import points
from ltm_ros.cli.record import record, replay
from ltm_ros.cli.reprocess import reprocess
from ltm_ros.cli.run import certs, region, run
from ltm_ros.cli.tower import doctor, rollback, status, upgrade
from ltm_ros.cli.trace import trace, viewshed
from ltm_ros.cli.train import train
from ltm_ros.cli.view import view

os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # else it searches all installed packages at each start

_PLACE_ERRORS = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a file or file system that the user must fix; it may have changed since the command's checks."""


def run_command_line(cli: typer.Typer, program: str, extras: dict[str, str]) -> None:
    """Run `cli` as `program`. `extras`: what to install for each optional Python package."""
    if not sys.stdout.isatty():
        os.environ.setdefault("COLUMNS", "120")  # wide enough that tables in a log lose no figures
    try:
        cli()
    except LtmError as error:
        print(f"{program}: {error}", file=sys.stderr)
        sys.exit(1)
    except OSError as error:
        if error.errno not in _PLACE_ERRORS:
            raise
        print(f"{program}: {error.filename or 'a file'}: {error.strerror}", file=sys.stderr)
        sys.exit(1)
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing not in extras:
            raise
        print(f"{program}: needs {error.name}: pip install '{extras[missing]}', or see `ltm doctor`", file=sys.stderr)
        sys.exit(1)


class CommandsByHeading(TyperGroup):
    """Lists commands below the headings of their `rich_help_panel`: plain text, because rich takes 0.2 s to load."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands with the first sentences of their help."""
        rows: dict[str, list[tuple[str, str]]] = {}
        for name, command in self.commands.items():
            heading = getattr(command, "rich_help_panel", None)
            rows.setdefault(heading if isinstance(heading, str) else "Commands", []).append(
                (name, command.get_short_help_str(formatter.width - 14))
            )
        for heading, commands in rows.items():
            with formatter.section(heading):
                formatter.write_dl(commands)


cli = typer.Typer(
    name="ltm",
    cls=CommandsByHeading,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"ltm {version('ltm')}")
        raise typer.Exit


@cli.callback()
def _options(
    version: Annotated[  # the callback prints it
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version and exit.")
    ] = False,
) -> None:
    """Live terrain and fuel maps from fire-watch cameras."""


pose = typer.Typer(no_args_is_help=True, help="Find a camera's pose from points, from a photo, or for a PTZ head.")
for method in (points, photo, mount):
    pose.command()(method)

START, POSES, MAPS, RECORDINGS, TOWER, NETWORKS = (
    "Start here",
    "Cameras and poses",
    "Maps",
    "Recordings",
    "Tower and region",
    "Networks",
)
"""Headings under which `ltm --help` lists the commands."""

cli.command(rich_help_panel=START)(demo)
cli.command(rich_help_panel=START)(check)
cli.command(rich_help_panel=START)(run)
cli.command(rich_help_panel=START)(view)
cli.add_typer(cameras, name="cameras", rich_help_panel=POSES)
cli.add_typer(pose, name="pose", rich_help_panel=POSES)
cli.command(rich_help_panel=POSES)(mask)
cli.command(rich_help_panel=POSES)(label)
cli.add_typer(train, name="train", rich_help_panel=POSES)
cli.command(rich_help_panel=POSES)(locate)
cli.command(rich_help_panel=POSES)(viewshed)
cli.command(rich_help_panel=POSES)(trace)
cli.command(rich_help_panel=MAPS)(export)
cli.command(rich_help_panel=MAPS)(fire)
cli.command(rich_help_panel=RECORDINGS)(record)
cli.command(rich_help_panel=RECORDINGS)(replay)
cli.command(name="import", rich_help_panel=RECORDINGS)(import_)
cli.command(rich_help_panel=RECORDINGS)(reprocess)
cli.command(rich_help_panel=TOWER)(status)
cli.command(rich_help_panel=TOWER)(doctor)
cli.command(rich_help_panel=TOWER)(upgrade)
cli.command(rich_help_panel=TOWER)(rollback)
cli.command(rich_help_panel=TOWER)(region)
cli.command(rich_help_panel=TOWER)(certs)
cli.command(rich_help_panel=NETWORKS)(models)

EXTRAS = {
    "rclpy": "ltm[ros]",
    "rerun": "ltm[view]",
    "matplotlib": "ltm[report]",
    "jinja2": "ltm[report]",
    "laspy": "ltm[export]",
    "pyarrow": "ltm[archive]",
    "fsspec": "ltm[archive]",
    "dask": "ltm[archive]",
    "distributed": "ltm[archive]",
    "s3fs": "ltm[archive]",
    "prometheus_client": "ltm[tower]",
    "paho": "ltm[region]",
    "cryptography": "ltm[region]",
}
"""What to install for each Python package that only some commands need."""


def app() -> None:
    """Run the command line `ltm`."""
    run_command_line(cli, "ltm", EXTRAS)


if __name__ == "__main__":
    app()
