"""`ltm-lab eval pose-watch`: the live watch of mounts on rendered frames: false alarms, detected turns, time."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_core.vision.manifest import DEFAULT_MODEL
from ltm_lab.cli.eval.trial_runner import Processes
from ltm_lab.options import JsonFile

if TYPE_CHECKING:
    from ltm_lab.evaluation.pose.mount_trial import WatchTrial


def pose_watch(
    folders: Annotated[list[Path], typer.Argument(help="Folders written by `ltm-lab simulate`.")],
    turn: Annotated[float, typer.Option(help="Turn of the cameras about the vertical, degrees.", min=0.1)] = 1,
    sigma: Annotated[float, typer.Option(help="Stated sigma of each angle of the poses, degrees.", min=0.01)] = 0.3,
    model: Annotated[str, typer.Option(help="Segmentation network.")] = DEFAULT_MODEL,
    processes: Processes = 1,
    json_path: JsonFile = None,
) -> None:
    """Show all frames of a camera to the watch of the node `pose`: twice with exact poses, which must raise no alarm,
    then as if the camera had been turned, which must be noticed."""
    from rich.console import Console

    from ltm_lab.cli.eval.score_table import print_table
    from ltm_lab.cli.eval.trial_runner import report, run_trials
    from ltm_lab.evaluation.pose.mount_trial import WatchJob, run_watch_job
    from ltm_lab.evaluation.pose.rendered_terrain_io import RenderedSite

    console = Console()
    jobs = [WatchJob(RenderedSite(folder, model), sigma, turn) for folder in folders]
    trials = run_trials(run_watch_job, jobs, processes, console)
    title = f"{len(trials)} cameras: poses exact, then {turn:g} deg of azimuth off"
    print_table(console, title, ("of the live watch", ""), _rows(trials))
    state = (
        f"{', '.join(f.name for f in folders)}: {sum(t.pictures for t in trials) // 2} rendered frames, each shown "
        f"twice; labels {model}; poses exact, {sigma:g} deg stated; with the DEM of the range around"
    )
    report(console, state, trials, json_path, turn_deg=turn, sigma_deg=sigma)


def _rows(trials: "list[WatchTrial]") -> list[tuple[str, str]]:
    import numpy as np

    from ltm_lab.evaluation.pose.pose_trial import Spread

    held = [trial for trial in trials if trial.held]
    noticed = [trial.noticed for trial in held if trial.noticed is not None]
    again = [trial for trial in held if trial.refitted]
    seconds = [s for trial in trials for s in trial.tracked_seconds] or [np.nan]

    def errors(name: str, values: list[tuple[float, float, float]]) -> list[tuple[str, str]]:
        angles = enumerate(("azimuth", "pitch", "roll"))
        title = "deg: median / p90 / greatest"
        return [(f"{name}, {angle}, {title}", str(Spread.of([v[k] for v in values]))) for k, angle in angles]

    most = f", after {np.median(noticed):.0f} clear images (at most {max(noticed)})" if noticed else ""
    low, high = np.quantile(seconds, (0.5, 0.9)) * 1e3
    return [
        ("images shown, clear", f"{sum(t.pictures for t in trials)}, {sum(t.clear for t in trials)}"),
        ("false alarms", str(sum(t.alarms for t in trials))),
        ("mounts found", f"{len(held)} of {len(trials)}"),
        *errors("correction off by", [t.error for t in held]),
        ("turn noticed", f"{len(noticed)} of {len(held)}{most}"),
        ("mounts found again", f"{len(again)} of {len(noticed)}"),
        *errors("then off by", [t.error_after for t in again]),
        ("CPU ms of a tracked image: median / p90", f"{low:.0f} / {high:.0f}"),
    ]
