"""`ltm-lab train blend`: averages the weights of two networks, of which one was trained on from the other."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import writable_folder


def blend(
    config: Annotated[Path, typer.Argument(help="Training configuration: name, sets held out, size.")],
    first: Annotated[str, typer.Argument(help="Manifest or name of a network of `ltm train`.")],
    second: Annotated[str, typer.Argument(help="That of a network whose training went on from it.")],
    frames: Annotated[Path, typer.Option(help="Folder of the sets of frames.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the model.", callback=writable_folder)],
    share: Annotated[float, typer.Option(min=0.0, max=1.0, help="Of the second in the weights' mean.")] = 0.5,
    threads: Annotated[int, typer.Option(help="CPU threads.")] = 2,
) -> None:
    """Weights between two networks: what the second learnt late without much of what it forgot (Wortsman et al. 2022).

    Both must descend from one training. The result is exported, calibrated and scored as after `ltm-lab train run`.
    """
    from rich.console import Console

    from ltm_core.storage.config_io import load_yaml
    from ltm_core.vision.labels import LabelSet
    from ltm_core.vision.manifest import NetworkManifest
    from ltm_lab.cli.train.training_run import finished, need_torch, report_scores
    from ltm_lab.training.config import TrainingConfig
    from ltm_lab.training.labelled_frames import read_split

    need_torch()
    from ltm_lab.training.exported import blended, load_exported

    settings, labels, console = load_yaml(config, TrainingConfig), LabelSet.load(), Console()
    network = blended(load_exported(NetworkManifest.find(first)), load_exported(NetworkManifest.find(second)), share)
    split = read_split(frames, settings.split, len(labels))
    manifest = finished(settings, network, split, labels, out, console)
    report_scores(settings, manifest, split, labels, threads, console)
