"""The command `ltm`. Commands import what they need when they run, so that `ltm --help` is quick."""

from __future__ import annotations

import errno
import os
import sys

import typer

from ltm_core.base.errors import LtmError
from ltm_lab.cli.bench import bench
from ltm_lab.cli.eval import evaluate
from ltm_lab.cli.simulate import simulate
from ltm_lab.cli.train import train
from ltm_ros.cli.cameras import cameras
from ltm_ros.cli.certs import certs
from ltm_ros.cli.check import check
from ltm_ros.cli.demo import demo
from ltm_ros.cli.doctor import doctor
from ltm_ros.cli.export import export
from ltm_ros.cli.fire import fire
from ltm_ros.cli.import_ import import_
from ltm_ros.cli.label import label
from ltm_ros.cli.locate import locate
from ltm_ros.cli.mask import mask
from ltm_ros.cli.models import models
from ltm_ros.cli.pose import pose
from ltm_ros.cli.record import record
from ltm_ros.cli.region import region
from ltm_ros.cli.replay import replay
from ltm_ros.cli.reprocess import reprocess
from ltm_ros.cli.run import run
from ltm_ros.cli.status import status
from ltm_ros.cli.trace import trace
from ltm_ros.cli.upgrade import rollback, upgrade
from ltm_ros.cli.view import view
from ltm_ros.cli.viewshed import viewshed

cli = typer.Typer(
    name="ltm",
    help="Live terrain and fuel maps from fire-watch cameras.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_show_locals=False,
)
cli.command()(demo)
cli.command()(check)
cli.command()(run)
cli.command()(replay)
cli.command()(reprocess)
cli.add_typer(cameras, name="cameras")
cli.command()(record)
cli.command(name="import")(import_)
cli.command()(trace)
cli.command()(pose)
cli.command()(viewshed)
cli.command()(locate)
cli.command()(mask)
cli.command()(label)
cli.command()(simulate)
cli.add_typer(train, name="train")
cli.command()(export)
cli.command()(fire)
cli.command()(view)
cli.command()(status)
cli.command()(doctor)
cli.command()(upgrade)
cli.command()(rollback)
cli.command()(models)
cli.command()(region)
cli.command()(certs)
cli.add_typer(bench, name="bench")
cli.add_typer(evaluate, name="eval")

_PLACE_ERRORS = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""A file or a file system that the user must see to: what was checked before may change while a command works."""


def app() -> None:
    """Entry point: bad input ends with a message and status 1, not with a traceback."""
    if not sys.stdout.isatty():
        os.environ.setdefault("COLUMNS", "120")  # a log is no 80 characters wide: tables would lose figures
    try:
        cli()
    except LtmError as error:
        print(f"ltm: {error}", file=sys.stderr)
        sys.exit(1)
    except OSError as error:
        if error.errno not in _PLACE_ERRORS:
            raise
        print(f"ltm: {error.filename or 'a file'}: {error.strerror}", file=sys.stderr)
        sys.exit(1)
    except ModuleNotFoundError as error:
        extra = {
            "rclpy": "ros",
            "rerun": "view",
            "mitsuba": "sim",
            "torch": "train",
            "matplotlib": "report",
            "jinja2": "report",
            "laspy": "export",
            "pyarrow": "archive",
            "fsspec": "archive",
            "dask": "archive",
            "distributed": "archive",
            "s3fs": "archive",
            "prometheus_client": "tower",
            "paho": "region",
            "cryptography": "region",
            "rosbags": "eval",
            "skimage": "eval",
        }.get((error.name or "").partition(".")[0])
        if extra is None:
            raise
        print(f"ltm: needs {error.name}: pip install 'ltm[{extra}]', or see `ltm doctor`", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    app()
