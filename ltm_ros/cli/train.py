"""`ltm train`: train the segmentation network on rendered frames, export it and print what it is worth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def train(
    config: Annotated[Path, typer.Option(help="Training configuration, such as config/training/spine.yaml.")],
    frames: Annotated[
        Path | None, typer.Option(help="Folder of <scenario>/NNNN.png with NNNN_labels.png; overrides the config's.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the model (default out/train/<name>).")] = None,
    steps: Annotated[int | None, typer.Option(help="Training steps, instead of the configuration's.")] = None,
    threads: Annotated[int, typer.Option(help="CPU threads.")] = 2,
) -> None:
    """Train a segmentation network; writes its ONNX file, manifest and scores, and prints the scores."""
    import json

    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from ltm_core.config_io import load_yaml
    from ltm_core.errors import ConfigError
    from ltm_core.vision.evaluate import score_segmenter, segment_milliseconds
    from ltm_core.vision.labels import LabelSet
    from ltm_core.vision.segmenter import Segmenter
    from ltm_core.vision.train.config import TrainingConfig
    from ltm_core.vision.train.frames import read_split
    from ltm_ros.cli.score_table import score_table

    try:
        import torch

        from ltm_core.vision.train import loop
        from ltm_core.vision.train.export import export
    except ModuleNotFoundError as reason:
        raise ConfigError(f"training needs {reason.name}; install it with: pip install 'ltm[train]'") from reason

    settings = load_yaml(config, TrainingConfig)
    if steps is not None:
        optimiser = settings.optimiser.model_copy(update={"steps": steps})
        settings = settings.model_copy(update={"optimiser": optimiser})
    folder = frames or settings.frames
    if folder is None:
        raise ConfigError(f"{config}: no frames; name their folder with --frames or as `frames` in the configuration")
    out = out or Path("out/train") / settings.name
    labels, console = LabelSet.load(), Console()
    split = read_split(folder, settings.split, len(labels))
    parts = {"train": split.train, "validation": split.validation, "test": split.test}
    for part, part_frames in parts.items():
        scenarios = sorted({frame.path.parent.name for frame in part_frames})
        console.print(f"{part}: {len(part_frames)} frames of {', '.join(scenarios) or 'no scenario'}")
    torch.set_num_threads(threads)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("training", total=settings.optimiser.steps)

        def report(progress: loop.Progress) -> None:
            bar.update(task, completed=progress.step, description=f"training, loss {progress.loss:.3f}")
            if progress.step % 50 == 0:
                console.print(f"step {progress.step}: loss {progress.loss:.3f}")
            if progress.validation is not None:
                iou = progress.validation.mean_iou
                console.print(f"step {progress.step}: validation mean IoU {iou:.3f}")

        network, validation = loop.train(settings, split, len(labels), report)
    manifest = export(network, settings, labels, out)
    segmenter = Segmenter.open(manifest)
    test = score_segmenter(segmenter, ((frame.image, frame.labels) for frame in split.test))
    milliseconds = segment_milliseconds(segmenter, [frame.image for frame in split.test[:4]])
    console.print(score_table(labels.names, test, f"{settings.name} on {', '.join(settings.split.test)} (unseen)"))
    if split.validation:
        console.print(f"validation mean IoU {validation.mean_iou:.3f}")
    console.print(f"one thread, {split.test[0].labels.shape[1]} px wide frames: {_median_text(milliseconds)}")
    size = manifest.with_suffix(".onnx").stat().st_size
    console.print(f"wrote {manifest} and {manifest.with_suffix('.onnx').name} ({size / 1e6:.2f} MB)")
    scores = {
        "frames": {part: len(part_frames) for part, part_frames in parts.items()},
        "test_mean_iou": test.mean_iou,
        "test_confusion": test.confusion.tolist(),
    }
    (out / f"{settings.name}_scores.json").write_text(json.dumps(scores, indent=1))


def _median_text(milliseconds: object) -> str:
    import numpy as np

    values = np.asarray(milliseconds, np.float64)
    return f"median {np.median(values):.1f} ms, p95 {np.percentile(values, 95):.1f} ms a frame"
