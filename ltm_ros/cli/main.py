"""The command `ltm`. Commands import what they need when they run, so that `ltm --help` is quick."""

from __future__ import annotations

import typer

from ltm_ros.cli.cameras import cameras
from ltm_ros.cli.certs import certs
from ltm_ros.cli.check import check
from ltm_ros.cli.demo import demo
from ltm_ros.cli.doctor import doctor
from ltm_ros.cli.entry import run_command_line
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
from ltm_ros.cli.train import train
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
