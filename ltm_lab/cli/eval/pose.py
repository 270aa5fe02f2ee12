"""`ltm-lab eval pose`: poses found in rendered images, or in a real one with control points, against the truth."""

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_core.vision.manifest import DEFAULT_MODEL
from ltm_lab.cli.eval.trial_runner import Processes
from ltm_lab.options import JsonFile

if TYPE_CHECKING:
    from rich.console import Console

    from ltm_lab.evaluation.pose.mount_trial import MountTrial
    from ltm_lab.evaluation.pose.pose_trial import PoseScore


class SkyLabels(StrEnum):
    """Where the labels come from."""

    model = "model"
    truth = "truth"


def pose(
    folders: Annotated[list[Path] | None, typer.Argument(help="Folders written by `ltm-lab simulate`.")] = None,
    engabreen: Annotated[
        Path | None, typer.Option(help="Folder of the real photo with control points, instead of rendered sites.")
    ] = None,
    sensors: Annotated[str, typer.Option(help="Sensors of the disturbed poses, separated by commas.")] = (
        "mount,phone,no heading"
    ),
    draws: Annotated[int, typer.Option(help="Number of disturbed poses of each frame and sensor.", min=1)] = 1,
    labels: Annotated[SkyLabels, typer.Option(help="Labels that the search gets.")] = SkyLabels.model,
    model: Annotated[str, typer.Option(help="Segmentation network.")] = DEFAULT_MODEL,
    open_views: Annotated[bool, typer.Option("--open", help="Leave out the DEM of the surroundings.")] = False,
    canopy: Annotated[bool, typer.Option("--canopy", help="Add the true surface raster to bare earth.")] = False,
    focal: Annotated[
        float, typer.Option(help="Largest error of focal lengths, as a share; they are then fitted.", min=0, max=0.2)
    ] = 0.0,
    mounts: Annotated[
        bool, typer.Option("--mounts", help="Also fit all frames of a camera together, as presets of a PTZ head.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of the disturbances.")] = 1,
    every: Annotated[int, typer.Option(help="Use each n-th frame of a folder.", min=1)] = 1,
    processes: Processes = 1,
    json_path: JsonFile = None,
) -> None:
    """Disturb true poses as sensors do, find them again in the images, and score the result."""
    from dataclasses import asdict

    from rich.console import Console

    from ltm_core.base.errors import ConfigError
    from ltm_lab.cli.eval.score_table import print_table
    from ltm_lab.cli.eval.trial_runner import report, run_trials
    from ltm_lab.evaluation.pose.engabreen_io import VARIANTS, RealJob, run_real_job
    from ltm_lab.evaluation.pose.mount_trial import MountTrial, run_pose_job
    from ltm_lab.evaluation.pose.pose_trial import PoseJob, PoseScore, PoseTrial, Sensor
    from ltm_lab.evaluation.pose.rendered_terrain_io import RenderedSite

    console = Console()
    if engabreen is not None:
        real = run_trials(run_real_job, [RealJob(engabreen, model, name) for name in VARIANTS], processes, console)
        columns = ("start", "verdict", "azimuth", "pitch", "roll", "place, m", "focal", "RMSE, m", "median, m", "CPU s")
        for name in VARIANTS:
            rows = [
                ("{:+.0f} {:+.0f} {:+.0f}".format(*t.start), t.verdict, *(f"{e:+.3f}" for e in t.error),
                 f"{t.moved:.1f}", f"{t.focal:.4f}", f"{t.rmse:.1f}", f"{t.median:.1f}", f"{t.seconds:.1f}")
                for t in real if t.variant == name
            ]  # fmt: skip
            print_table(console, f"{len(rows)} starts, 10 deg of azimuth and 3 of pitch off; {name}", columns, rows)
        state = "errors from the control points' pose; RMSE and median of control points on ground that the DEM shows"
        report(console, state, real, json_path)
        return
    if not folders:
        raise ConfigError(
            "no folder to score: give folders of `ltm-lab simulate`, or --engabreen with the real photo's"
        )
    try:
        kinds = tuple(Sensor(name.strip()) for name in sensors.split(","))
    except ValueError as error:
        raise ConfigError(f"--sensors {sensors}: {error}; known are {', '.join(Sensor)}") from error
    network = model if labels is SkyLabels.model else ""
    sites = [RenderedSite(folder, network, open_views, canopy, every) for folder in folders]
    jobs = [PoseJob(site, kinds, draws, focal, mounts, seed) for site in sites]
    found = run_trials(run_pose_job, jobs, processes, console)
    trials = [trial for trial in found if isinstance(trial, PoseTrial)]
    heads = [trial for trial in found if isinstance(trial, MountTrial)]
    scores = PoseScore.by_view(trials)
    _print_scores(console, scores)
    if heads:
        _print_heads(console, heads)
    state = (
        f"{', '.join(f.name for f in folders)}: {len({t.frame for t in trials})} rendered frames, {draws} draws each, "
        f"labels {network or labels.value}, seed {seed}"
        + (f", one frame of {every}" if every > 1 else "")
        + (", DEM of the site alone" if open_views else ", with the 10 m DEM of the range around")
        + (", with the true surface raster" if canopy else "")
        + (f", focal lengths off by up to {focal:.0%}" if focal else "")
    )
    report(console, state, found, json_path, scores={name: asdict(score) for name, score in scores.items()})


def _print_scores(console: "Console", scores: "dict[str, PoseScore]") -> None:
    from ltm_lab.cli.eval.score_table import print_table

    columns = ("skyline, pose from", "trials", "accepted", "azimuth", "pitch", "roll", "place", "place before",
               "off > 1, > 2", "1.48 med |z|", "CPU s")  # fmt: skip
    rows: list[Sequence[object]] = []
    for name, s in scores.items():
        rows.append(
            (name, s.trials, f"{s.accepted / s.trials:.0%}", *s.angles, f"{s.traced:.0f}", f"{s.traced_before:.0f}",
             f"{s.wrong_by_1}, {s.wrong_by_2}", " ".join(f"{z:.2f}" for z in s.z),
             f"{s.seconds.median:.2f} / {s.seconds.p90:.2f}")
        )  # fmt: skip
        if s.focal_percent.greatest > 0:
            rows.append(("  focal length, %", "", "", s.focal_percent))
    title = "errors of accepted poses: median / p90 / greatest, degrees (place: metres at about 1 km)"
    print_table(console, title, columns, rows)


def _print_heads(console: "Console", heads: "list[MountTrial]") -> None:
    import numpy as np

    from ltm_lab.cli.eval.score_table import print_table
    from ltm_lab.evaluation.pose.pose_trial import Spread, typical_z

    taken = [head for head in heads if head.verdict == "accepted"]
    errors = np.array([error for head in taken for error in head.errors]).reshape(-1, 3)
    z = typical_z([z for head in taken for z in head.z])
    row = (len(heads), len(taken), *(Spread.of(errors[:, k]) for k in range(3)), " ".join(f"{v:.2f}" for v in z),
           Spread.of([100 * (head.focal - 1) for head in taken]))  # fmt: skip
    title = "PTZ heads whose presets were fitted together: errors of their images, degrees"
    columns = ("heads", "accepted", "azimuth", "pitch", "roll", "1.48 med |z|", "focal length, %")
    print_table(console, title, columns, [row])
