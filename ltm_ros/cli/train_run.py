"""One training run on the terminal: progress, checkpoint, curve, export, calibration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from ltm_core.errors import ConfigError
from ltm_core.vision.labels import LabelSet

if TYPE_CHECKING:
    from ltm_core.vision.train.config import TrainingConfig
    from ltm_core.vision.train.frames import Split


def need_torch() -> None:
    """Raises ConfigError that names what to install where PyTorch or ONNX is absent."""
    try:
        import onnx  # noqa: F401
        import torch  # noqa: F401
    except ModuleNotFoundError as reason:
        raise ConfigError(f"training needs {reason.name}; install it with: pip install 'ltm[train]'") from reason


def trained(
    settings: TrainingConfig,
    split: Split,
    labels: LabelSet,
    out: Path,
    threads: int,
    console: Console,
    resume: bool = False,
    start: Path | None = None,
    until: int | None = None,
) -> Path:
    """Train, export into `out` and calibrate on the validation sets; gives the manifest's path."""
    import torch
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from ltm_core.vision.train import loop
    from ltm_core.vision.train.curve_io import write_curve
    from ltm_core.vision.train.export import export
    from ltm_core.vision.train.finish import calibrate

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
                console.print(f"step {progress.step}: validation mean F1 {progress.validation.mean_f1:.3f}")

        network, run = loop.train(settings, split, len(labels), report, run, checkpoint, until)
    write_curve(out / f"{settings.name}_curve.png", settings.name, run)
    manifest = export(network, settings, labels, out)
    if split.validation:
        temperature, _ = calibrate(manifest, split.validation, labels, settings.seed)
        console.print(f"temperature {temperature:.3f}; confusion in {settings.name}_calibration.yaml")
    size = manifest.with_suffix(".onnx").stat().st_size
    console.print(f"wrote {manifest} and {manifest.with_suffix('.onnx').name} ({size / 1e6:.2f} MB)")
    return manifest


def _run(settings: TrainingConfig, classes: int, checkpoint: Path, resume: bool, start: Path | None):  # type: ignore[no-untyped-def]  # noqa: ANN202
    import torch

    from ltm_core.vision.train import loop

    if resume:
        if not checkpoint.is_file():
            raise ConfigError(f"{checkpoint}: no checkpoint to resume from; train without --resume")
        return loop.Run.resume(checkpoint, settings, classes)
    if start is not None:
        if not start.is_file():
            raise ConfigError(f"{start}: no such checkpoint to start from")
        content = torch.load(start, map_location="cpu", weights_only=True)
        return loop.Run.start(settings, classes, content["best_state"] or content["average"])
    return loop.Run.start(settings, classes)
