"""Runs one training on the terminal: progress, checkpoint, curve, export, calibration."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from ltm_core.base.errors import ConfigError
from ltm_core.vision.labels import LabelSet

if TYPE_CHECKING:
    from ltm_lab.training.config import TrainingConfig
    from ltm_lab.training.training_frames import Split


def need_torch() -> None:
    """Raises ConfigError that names what to install where PyTorch or ONNX is absent."""
    try:
        import onnx  # noqa: F401
        import torch  # noqa: F401
    except ModuleNotFoundError as reason:
        raise ConfigError(f"training needs {reason.name}; install it with: pip install './ltm_lab[train]'") from reason


def trained(
    settings: "TrainingConfig",
    split: "Split",
    labels: LabelSet,
    out: Path,
    threads: int,
    console: Console,
    resume: bool = False,
    start: str | None = None,
) -> Path:
    """Train, export into `out` and calibrate on the validation sets; gives the manifest's path."""
    import torch
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from ltm_lab.training import loop
    from ltm_lab.training.curve_io import write_curve
    from ltm_lab.training.export import export
    from ltm_lab.training.finish import calibrate

    for part, frames in (("train", split.train), ("validation", split.validation), ("test", split.test)):
        sets = sorted({frame.path.parent.name for frame in frames})
        console.print(f"{part}: {len(frames)} frames of {', '.join(sets) or 'no set'}")
    torch.set_num_threads(threads)
    out.mkdir(parents=True, exist_ok=True)
    checkpoint = out / "checkpoint.pt"
    run = _run(settings, len(labels), checkpoint, resume, start)
    console.print(f"on {loop.device().type}, {threads} threads, from step {run.step} of {settings.optimiser.steps}")
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("training", total=settings.optimiser.steps, completed=run.step)

        def report(progress: loop.Progress) -> None:
            bar.update(task, completed=progress.step, description=f"training, loss {progress.loss:.3f}")
            if progress.step % 100 == 0:
                console.print(f"step {progress.step}: loss {progress.loss:.3f}")
            if progress.validation is not None:
                console.print(f"step {progress.step}: validation mean F1 {progress.validation.macro_f1():.3f}")

        network, run = loop.train(settings, split, len(labels), report, run, checkpoint)
    write_curve(out / f"{settings.name}_curve.png", settings.name, run)
    manifest = export(network, settings, labels, out)
    if split.validation:
        temperature, _ = calibrate(manifest, split.validation, labels, settings.seed)
        console.print(f"temperature {temperature:.3f}; confusion in reliability/{settings.name}_*.yaml")
    size = manifest.with_suffix(".onnx").stat().st_size
    console.print(f"wrote {manifest} and {manifest.with_suffix('.onnx').name} ({size / 1e6:.2f} MB)")
    return manifest


def _run(settings: "TrainingConfig", classes: int, checkpoint: Path, resume: bool, start: str | None):  # type: ignore[no-untyped-def]  # noqa: ANN202
    from ltm_lab.training import loop

    if resume:
        if not checkpoint.is_file():
            raise ConfigError(f"{checkpoint}: no checkpoint to resume from; train without --resume")
        return loop.Run.resume(checkpoint, settings, classes)
    if start is not None:
        return loop.Run.start(settings, classes, _weights(start, settings.network.fixed))
    return loop.Run.start(settings, classes)


def _weights(start: str, fixed: int) -> dict[str, Any]:
    """Of a checkpoint, or of the network that a manifest or a model's name gives."""
    import torch

    from ltm_core.vision.manifest import NetworkManifest
    from ltm_lab.training.export import load_exported

    weights: dict[str, Any]
    if not start.endswith(".pt"):
        weights = load_exported(NetworkManifest.find(start), fixed).state_dict()
        return weights
    if not Path(start).is_file():
        raise ConfigError(f"{start}: no such checkpoint to start from")
    content: dict[str, Any] = torch.load(start, map_location="cpu", weights_only=True)
    weights = content["best_state"] or content["average"]
    return weights


def report_scores(
    settings: "TrainingConfig", manifest: Path, split: "Split", labels: LabelSet, threads: int, console: Console
) -> None:
    """Print the finished network's scores on the held-out sets and write them to `<name>_scores.json` beside it."""
    import json

    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.cli.eval.segmentation_tables import print_class_scores
    from ltm_lab.training.finish import score_sets

    segmenter = Segmenter.open(manifest, threads)
    found = {"validation": score_sets(segmenter, split.validation), "test": score_sets(segmenter, split.test)}
    report: dict[str, object] = {"name": settings.name, "seed": settings.seed, "steps": settings.optimiser.steps}
    for part, scores in found.items():
        for name, score in scores.items():
            title = f"{settings.name} on {name} ({part}); ECE {score.calibration.ece:.3f}"
            print_class_scores(console, labels.names, score.labels, title)
        report[part] = {
            name: {
                "macro_f1": score.labels.macro_f1(),
                "mean_iou": score.labels.mean_iou,
                "ece": score.calibration.ece,
                "confusion": score.labels.confusion.tolist(),
            }
            for name, score in scores.items()
        }
    (manifest.parent / f"{settings.name}_scores.json").write_text(json.dumps(report, indent=1))
