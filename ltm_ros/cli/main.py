"""The command `ltm`. Commands import what they need when they run, so that `ltm --help` is quick."""

from __future__ import annotations

import errno
import os
import re
import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ltm_core.base.errors import LtmError
from ltm_ros.cli.assess import assess
from ltm_ros.cli.cameras import cameras
from ltm_ros.cli.demo import demo
from ltm_ros.cli.export import export, fire
from ltm_ros.cli.init import init
from ltm_ros.cli.locate import locate
from ltm_ros.cli.mask import label, mask
from ltm_ros.cli.models import models
from ltm_ros.cli.pose_import import import_poses
from ltm_ros.cli.pose_mount import mount
from ltm_ros.cli.pose_photo import photo
from ltm_ros.cli.pose_points import points
from ltm_ros.cli.record import import_, record, replay
from ltm_ros.cli.reprocess import reprocess
from ltm_ros.cli.run import certs, check, region, run
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


EXAMPLES = {
    "": ("ltm demo", "ltm run site.yaml --state map --view"),
    "demo": ("ltm demo", "ltm demo --out /tmp/demo"),
    "init": (
        "ltm init --lonlat -118.06,34.22 --name ridge --radius 8km --out ridge",
        "ltm init --out ridge --camera east=-118.05,34.21,height=12,azimuth=180,hfov=60",
    ),
    "check": ("ltm check site.yaml", "ltm check site.yaml --out check.png"),
    "run": ("ltm run site.yaml --state map", "ltm run site.yaml --state map --view --record today"),
    "view": ("ltm view --site site.yaml", "ltm view --rrd out/demo/demo.rrd"),
    "cameras probe": (
        "ltm cameras probe http://192.168.1.20 --user viewer",
        "ltm cameras probe http://192.168.1.20 --site site.yaml --camera north --lonlat -118.06,34.22 --height 20 "
        "--azimuth 214 --hfov 54",
    ),
    "cameras snapshot": ("ltm cameras snapshot site.yaml north --out presets",),
    "pose points": ("ltm pose points points.csv --guess guess.yaml --dem dem.tif --out pose.yaml",),
    "pose photo": ("ltm pose photo photo.jpg --guess guess.yaml --dem dem.tif --out pose.yaml --picture found.png",),
    "pose import": ("ltm pose import cameras.xml --dem dem.tif --photos photos --out poses --picture drawn",),
    "pose mount": ("ltm pose mount site.yaml north --photos presets",),
    "mask": (
        "ltm mask west_photos/ --site site.yaml --camera west",
        "ltm mask west_photos/ --site site.yaml --camera west --keep 1,3",
    ),
    "label": ("ltm label photos/",),
    "train head": ("ltm train head photos/ --out chaparral",),
    "locate": (
        "ltm locate --site site.yaml --mark north=812,430",
        "ltm locate --site site.yaml --lonlat -118.05,34.21 --out place",
    ),
    "viewshed": ("ltm viewshed --site site.yaml --out coverage.tif --target-height 50",),
    "trace": ("ltm trace --dem dem.tif --pose pose.yaml --image photo.jpg --out traced",),
    "export": (
        "ltm export map/fuel_map.ltm --site site.yaml --out map.png",
        "ltm export map/fuel_map.ltm --site site.yaml --out landscape.lcp --crs EPSG:5070",
        "ltm export map/fuel_map.ltm --site site.yaml --out change.png --format change --since 2026-05-31",
    ),
    "fire": (
        "ltm fire map/fuel_map.ltm --site site.yaml --ignition 348400,3784900 --wind 6,80 --moisture D2L2 --hours 6",
        "ltm fire now.lcp --before was.lcp --ignition -117.5,33.6 --ignition-crs EPSG:4326 --wind 8,20 --moisture D1L1",
    ),
    "assess plan": ("ltm assess plan map/fuel_map.ltm --site site.yaml --cells 300 --out plan",),
    "assess look": ("ltm assess look plan --recordings today",),
    "assess learn": ("ltm assess learn plan --recordings today",),
    "assess report": ("ltm assess report plan --out report.html --recordings today",),
    "record": ("ltm record --site site.yaml --out today", "ltm record --site site.yaml --out depth '/ridge/*/depth/*'"),
    "replay": (
        "ltm replay today --site site.yaml --offline --out replayed",
        "ltm replay today --site site.yaml --out replayed --rate 2",
    ),
    "import": (
        "ltm import photos/ --poses poses.csv --site site.yaml --out walk",
        "ltm import sensor_logger.zip --site site.yaml --out walk --focal-35mm 25",
    ),
    "reprocess": ("ltm reprocess archive/ --site site.yaml --out years --since 2024-01-01 --sample 4/day",),
    "status": ("ltm status site.yaml", "ltm status site.yaml --json"),
    "doctor": ("ltm doctor", "ltm doctor --site site.yaml"),
    "upgrade": ("ltm upgrade ltm_0.2.0_amd64.deb --ready-minutes 5",),
    "rollback": ("ltm rollback", "ltm rollback --to 0.1.0"),
    "region": ("ltm region region.yaml",),
    "certs": ("ltm certs certs/ --region valley --tower ridge --tower peak --host 10.8.0.1",),
    "models": ("ltm models", "ltm models check landscape_v4 --images photos/ --out labels"),
}
"""Examples in the help of each command; a group of commands shows the first ones of its commands."""

METAVARS = {
    "ADDRESS": "url listen interface",
    "AZIMUTH,PITCH": "looking",
    "CAMERA": "cameras only",
    "COUNT/PERIOD": "sample",
    "DATE": "as_of since until",
    "EPSG:CODE": "crs ignition_crs",
    "FOLDER": "bag",
    "KEY=VALUE": "stated",
    "LON,LAT": "lonlat",
    "MODEL": "model named like",
    "NUMBER": "cells domain rate seed tries",
    "NUMBERS": "keep",
    "PORT": "web_port grpc_port",
    "PROBABILITY": "confidence",
    "SCENARIO": "moisture",
    "SHARE": "max_failed",
    "SPEED,DIRECTION": "wind",
    "VARIABLE": "password_env",
    "VERSION": "to",
    "X,Y": "place ignition",
}
"""What goes into options whose name and help do not show it."""

UNITS = ("degrees", "metres", "seconds", "minutes", "hours", "days", "GB", "mm", "pixels")


def metavar_of(name: str, text: str, is_path: bool) -> str:
    """Return what help shows as the value of an option: by its name, by file, folder or unit in its help text, or else
    its name."""
    if named := next((metavar for metavar, names in METAVARS.items() if name in names.split()), None):
        return named
    if is_path:
        kind = re.search(r"file|folder", text.lower().partition(".")[0])
        return kind[0].upper() if kind else "FILE"
    unit = next((unit for unit in UNITS if re.search(rf"\b{unit}\b", text)), name)
    return unit.upper()


class HelpfulGroup(TyperGroup):
    """Completes the help of all commands with examples and metavars, and lists commands below the headings of their
    `rich_help_panel`: plain text, because rich takes 0.2 s to load."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        _complete(self, "")

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


def _complete(command: Any, path: str) -> None:
    for name, child in getattr(command, "commands", {}).items():
        _complete(child, f"{path} {name}".strip())
    below = [lines[0] for name, lines in EXAMPLES.items() if name.startswith(f"{path} ")]
    command.epilog = "\n\n".join(("Examples:", *EXAMPLES.get(path, below)))
    for param in [*command.params, command.get_help_option(typer.Context(command, **HELP))]:
        kind = param.type_descriptor
        if param.param_type_name == "argument":
            param.metavar = param.metavar or param.name.upper()
            param.display_type_rich = lambda ctx: ""  # its name says what it is
        elif param.metavar is None and kind.choices is None:
            of = metavar_of(param.name, param.help or "", "Path" in str(kind.annotation))
            param.metavar = "" if param.is_flag else of


HELP: dict[str, Any] = {"help_option_names": ["-h", "--help"], "max_content_width": 120}

cli = typer.Typer(
    name="ltm",
    cls=HelpfulGroup,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings=HELP,
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


pose = typer.Typer(no_args_is_help=True, help="Find or import camera poses; calibrate a PTZ mount.")
for method in (points, photo, mount):
    pose.command()(method)
pose.command("import")(import_poses)

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
cli.command(rich_help_panel=START)(init)
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
cli.add_typer(assess, name="assess", rich_help_panel=MAPS)
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
    "tokenizers": "ltm[text]",
    "pyarrow": "ltm[archive]",
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
