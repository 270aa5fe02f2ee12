"""`ltm train`: trains the default network, and fits constants of fuel and fusion.

It also labels photos to train on. `ltm-lab train CONFIG` is short for `ltm-lab train run CONFIG`.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer.core import TyperGroup

from ltm_lab.cli.train.appearance import appearance
from ltm_lab.cli.train.fusion import fusion
from ltm_lab.cli.train.photos import photos
from ltm_lab.options import writable_folder

if TYPE_CHECKING:
    from ltm_lab.training.config import TrainingConfig

WHOLE = "run"
"""The command that runs where the first argument is no command: one training run."""


class TrainGroup(TyperGroup):
    """A group whose default command is `run`: `ltm-lab train ltm_lab/config/training/landscape_v5.yaml`."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        if args and args[0] not in self.commands and args[0] not in ("--help", "-h"):
            args = [WHOLE, *args]
        return super().parse_args(ctx, args)


def run(
    config: Annotated[
        Path, typer.Argument(help="Training configuration, such as ltm_lab/config/training/landscape_v5.yaml.")
    ],
    frames: Annotated[
        Path | None, typer.Option(help="Folder of <set>/NAME.png with NAME_labels.png; overrides the config's.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the model (default out/train/<name>).", callback=writable_folder)
    ] = None,
    steps: Annotated[int | None, typer.Option(help="Training steps, instead of the configuration's.")] = None,
    threads: Annotated[int, typer.Option(help="CPU threads.")] = 2,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the checkpoint in the folder.")] = False,
    start: Annotated[
        str | None,
        typer.Option(help="Weights to start from: another run's checkpoint .pt, a manifest or model's name."),
    ] = None,
) -> None:
    """Train the network of CONFIG: checkpoints, a picture of the course, ONNX file, manifests, calibration, scores."""
    from rich.console import Console

    from ltm_core.base.errors import ConfigError
    from ltm_core.storage.config_io import load_yaml
    from ltm_core.vision.labels import LabelSet
    from ltm_lab.cli.train.training_run import need_torch, report_scores, trained
    from ltm_lab.training.config import TrainingConfig
    from ltm_lab.training.training_frames import read_split

    need_torch()
    settings = load_yaml(config, TrainingConfig)
    if steps is not None:
        settings = _with_steps(settings, steps)
    folder = frames or settings.frames
    if folder is None:
        raise ConfigError(f"{config}: no frames; name their folder with --frames or as `frames` in the configuration")
    out = out or Path("out/train") / settings.name
    writable_folder(out)
    labels, console = LabelSet.load(), Console()
    split = read_split(folder, settings.split, len(labels))
    manifest = trained(settings, split, labels, out, threads, console, resume=resume, start=start)
    report_scores(settings, manifest, split, labels, threads, console)


def _with_steps(settings: "TrainingConfig", steps: int) -> "TrainingConfig":
    return settings.model_copy(update={"optimiser": settings.optimiser.model_copy(update={"steps": steps})})


train = typer.Typer(cls=TrainGroup, no_args_is_help=True, help="Train the network; fit constants of fuel and fusion.")
train.command(WHOLE)(run)
train.command()(fusion)
train.command()(photos)
train.command()(appearance)
