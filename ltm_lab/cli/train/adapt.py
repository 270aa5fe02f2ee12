"""`ltm-lab train adapt`: adapts a network's depth head to a site's own views, with traced depth as truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import writable_folder


def adapt(
    bag: Annotated[Path, typer.Argument(help="Bag folder or .mcap file of the site's cameras.")],
    site: Annotated[Path | None, typer.Option("--site", help="Site file; default: site.yaml beside the bag.")] = None,
    model: Annotated[
        str | None, typer.Option(help="Network of `ltm train` to adapt; default: the shipped one.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the adapted network; default: <model>_<site>.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for it (default out/train/<name>).", callback=writable_folder)
    ] = None,
    steps: Annotated[int, typer.Option(min=1, help="Training steps.")] = 200,
    threads: Annotated[int, typer.Option(help="CPU threads.")] = 2,
) -> None:
    """Teach the depth head on the traced depth of BAG's own frames; labels stay as they are. No labels are needed."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from ltm_core.base.errors import ConfigError
    from ltm_core.site.site_io import load_site
    from ltm_core.vision.labels import LabelSet
    from ltm_core.vision.manifest import DEFAULT_MODEL, NetworkManifest
    from ltm_lab.cli.train.training_run import need_torch
    from ltm_ros.cli.output import message_bar

    need_torch()
    import torch

    from ltm_lab.evaluation.traced_frames import traced_frames
    from ltm_lab.training.adapt import AdaptConfig, adapted, depth_error
    from ltm_lab.training.export import export_adapted, load_exported

    console = Console()
    place = site or next((p for p in (bag / "site.yaml", bag.parent / "site.yaml") if p.is_file()), None)
    if place is None:
        raise ConfigError(f"{bag}: no site.yaml beside it; name the site file with --site")
    manifest = NetworkManifest.find(model or DEFAULT_MODEL)
    network = load_exported(manifest)
    name = name or f"{manifest.name}_{load_site(place).name}"
    out = out or Path("out/train") / name
    config = AdaptConfig(steps=steps, width=manifest.input.width, height=manifest.input.height)
    with message_bar(console, "tracing") as progress:
        frames = traced_frames(bag, place, config.width, progress)
    # The last fifth of the recording judges: its frames come after all those that teach.
    kept = max(1, len(frames) // 5) if len(frames) > 4 else 0
    taught, judged = frames[: len(frames) - kept], frames[len(frames) - kept :] or frames
    torch.set_num_threads(threads)
    before = depth_error(network, judged, config)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("adapting", total=steps)
        network = adapted(
            network, taught, config, lambda step, loss: bar.update(task, completed=step, description=f"loss {loss:.3f}")
        )
    after = depth_error(network, judged, config)
    why = f"{manifest.name}, its depth adapted to a site by `ltm-lab train adapt`"
    written = export_adapted(network, manifest, name, LabelSet.load(), out, why)
    whose = f"{len(judged)} later frames" if kept else "the same frames"
    console.print(f"{len(taught)} frames taught; median depth error of {whose}: {before:.1%} before, {after:.1%} after")
    console.print(f"wrote {written}; its labels are those of {manifest.name}")
