"""The command `ltm`. The module of a command is imported when the command runs, so that `ltm --help` is quick."""

import ast
import atexit
import errno
import gc
import os
import re
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option
from typer.core import TyperGroup
from typer.main import get_command

from ltm_core.base.errors import LtmError
from ltm_ros.cli.output import command_group

os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # else it searches all installed packages at each start

COMMANDS = {
    "Start here": "demo.demo init.init check.check run.run view.view",
    "Cameras and poses": (
        "cameras.cameras pose_import.pose mask.mask mask.label train.train locate.locate trace.viewshed trace.trace"
    ),
    "Maps": "export.export export.fire assess.assess",
    "Recordings": "record.record record.replay record.import_ reprocess.reprocess",
    "Tower and region": "tower.status tower.doctor tower.upgrade tower.rollback run.region run.certs",
    "Networks": "models.models",
}
"""The commands by the heading under which `ltm --help` lists them, each as module.function."""

_PLACE_ERRORS = (errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC,
    errno.EDQUOT, errno.EFBIG)  # fmt: skip
"""Errors of a file or file system that the user must fix; it may have changed since the command's checks."""


def run_command_line(cli: typer.Typer, program: str, extras: dict[str, str]) -> None:
    """Run `cli` as `program`. `extras`: what to install for each optional Python package."""
    atexit.register(gc.freeze)  # else Python searches all objects for cycles when it ends: 0.2 s with numba's
    # Else NumPy's threads wait for work in a loop: a tenth of a second of processor time when NumPy is loaded.
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")
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
    "models": ("ltm models", "ltm models check landscape_v5 --images photos/ --out labels"),
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
    """Return what help shows as the value of an option: by its name, or by file, folder or unit in its help."""
    if named := next((metavar for metavar, names in METAVARS.items() if name in names.split()), None):
        return named
    if is_path:
        kind = re.search(r"file|folder", text.lower().partition(".")[0])
        return kind[0].upper() if kind else "FILE"
    unit = next((unit for unit in UNITS if re.search(rf"\b{unit}\b", text, re.IGNORECASE)), name)
    return unit.upper()


class Commands(Mapping[str, Any]):
    """The commands by name; the module of one is imported when it is looked up."""

    def __init__(self) -> None:
        listed = [place.split(".") for places in COMMANDS.values() for place in places.split()]
        self._places = {function.rstrip("_"): (module, function) for module, function in listed}

    def __getitem__(self, name: str) -> Any:
        module, function = self._places[name]
        command = getattr(import_module(f"ltm_ros.cli.{module}"), function)
        group = command if isinstance(command, typer.Typer) else command_group()
        if group is not command:
            group.command(name)(command)
        made = get_command(group)
        made.name = name
        _complete(made, name)
        return made

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def summary(self, name: str) -> str:
        """Return the first sentence of a command's help, which is read from its source without importing it."""
        module, function = self._places[name]
        text = ""
        for node in ast.parse((Path(__file__).parent / f"{module}.py").read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and node.name == function:
                text = ast.get_docstring(node) or ""
            elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == function:  # command_group(help)
                text = ast.literal_eval(node.value.args[0])  # type: ignore[attr-defined]
        return re.split(r"(?<=\.)\s", text)[0]


class HelpfulGroup(TyperGroup):
    """The command `ltm`: lists the commands below their headings, in plain text, because rich takes 0.2 s to load."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands: Any = Commands()
        _complete(self, "", below=False)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands with the first sentences of their help."""
        for heading, places in COMMANDS.items():
            names = [place.partition(".")[2].rstrip("_") for place in places.split()]
            with formatter.section(heading):
                formatter.write_dl([(name, self.commands.summary(name)) for name in names])


def _complete(command: Any, path: str, below: bool = True) -> None:
    """Add examples and metavars to the help of a command, and of those below it."""
    for name, child in getattr(command, "commands", {}).items() if below else ():
        _complete(child, f"{path} {name}")
    first = [lines[0] for name, lines in EXAMPLES.items() if name.startswith(f"{path} ")]
    command.epilog = "\n\n".join(("Examples:", *EXAMPLES.get(path, first)))
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
        bool, Option("--version", is_eager=True, callback=_print_version, help="Print the version and exit.")
    ] = False,
) -> None:
    """Live terrain and fuel maps from fire-watch cameras."""


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
