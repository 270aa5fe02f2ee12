"""`ltm-lab eval pose-watch`: the live watch of mounts on rendered frames: false alarms, turns that are noticed, time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_ros.cli.output import JsonFile

if TYPE_CHECKING:
    from rich.table import Table

    from ltm_lab.evaluation.pose.watch_trial import WatchTrial


def pose_watch(
    folders: Annotated[
        list[Path],
        typer.Argument(help="Folders of `ltm-lab simulate`, such as of ltm_lab/config/scenarios/pose_*.yaml."),
    ],
    turn: Annotated[float, typer.Option(help="Degrees by which cameras are then turned, unknown to all.", min=0.1)] = 1,
    sigma: Annotated[float, typer.Option(help="Degrees, stated of each angle of the poses.", min=0.01)] = 0.3,
    model: Annotated[str, typer.Option(help="Segmentation network; default: the shipped one.")] = "",
    json_path: JsonFile = None,
) -> None:
    """Show all frames of an eye, as of one camera, to the watch of the node `pose`: twice with exact poses, which must
    raise no alarm, then as if the camera had been turned, which must be noticed."""
    from collections import defaultdict
    from dataclasses import asdict

    from rich.console import Console

    from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
    from ltm_core.vision.manifest import DEFAULT_MODEL
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.evaluation.pose.pose_trial import PreparedFrame, prepared
    from ltm_lab.evaluation.pose.rendered_terrain_io import rendered_terrain
    from ltm_lab.evaluation.pose.watch_trial import run_watch_trial
    from ltm_lab.evaluation.truth_frames_io import read_truth_frames
    from ltm_ros.pages.figures_io import write_figures

    console, config = Console(), PicturePoseConfig()
    segmenter = Segmenter.open(model or DEFAULT_MODEL)
    trials = []
    for folder in folders:
        terrain = rendered_terrain(folder, alone=False, canopy=False)
        cameras: dict[str, list[PreparedFrame]] = defaultdict(list)
        with console.status(folder.name):
            for number, frame in enumerate(read_truth_frames(folder)):
                labels = segmenter.segment(frame.photo).labels
                ready = prepared(f"{folder.name}/{number:04d}", frame, labels, terrain, config)
                cameras[frame.camera_name].append(ready)
            for camera, frames in cameras.items():
                trials.append(run_watch_trial(f"{folder.name}/{camera}", frames, terrain, config, sigma, turn))
    console.print(_table(trials, turn))
    shown = sum(trial.pictures for trial in trials)
    console.print(
        f"conditions: {', '.join(f.name for f in folders)}: {shown // 2} rendered frames, each shown twice; labels "
        f"{model or DEFAULT_MODEL}; poses exact, {sigma:g} deg stated; with the DEM of the range around",
        highlight=False,
    )
    if json_path is not None:
        write_figures(json_path, {"turn_deg": turn, "sigma_deg": sigma, "cameras": [asdict(t) for t in trials]})


def _table(trials: list[WatchTrial], turn: float) -> Table:
    import numpy as np
    from rich.table import Table

    from ltm_lab.evaluation.pose.pose_score import Spread

    held = [trial for trial in trials if trial.held]
    noticed = [trial.noticed for trial in held if trial.noticed is not None]
    again = [trial for trial in held if trial.refitted]
    seconds = [s for trial in trials for s in trial.tracked_seconds]
    table = Table(
        "of the live watch", "", title=f"{len(trials)} cameras: poses exact, then {turn:g} deg of azimuth off"
    )
    table.add_row("pictures shown, clear", f"{sum(t.pictures for t in trials)}, {sum(t.clear for t in trials)}")
    table.add_row("false alarms", str(sum(t.alarms for t in trials)))
    table.add_row("mounts found", f"{len(held)} of {len(trials)}")

    def errors(name: str, chosen: list[WatchTrial], after: bool) -> None:
        for k, angle in enumerate(("azimuth", "pitch", "roll")):
            values = [(t.error_after if after else t.error)[k] for t in chosen]
            table.add_row(f"{name}, {angle}, deg: median / p90 / greatest", str(Spread.of(values)))

    errors("correction off by", held, after=False)
    most = f", after {np.median(noticed):.0f} clear pictures (at most {max(noticed)})" if noticed else ""
    table.add_row("turn noticed", f"{len(noticed)} of {len(held)}{most}")
    table.add_row("mounts found again", f"{len(again)} of {len(noticed)}")
    errors("then off by", again, after=True)
    if seconds:
        low, high = np.quantile(seconds, (0.5, 0.9)) * 1e3
        table.add_row("CPU ms of a tracked picture: median / p90", f"{low:.0f} / {high:.0f}")
    return table
