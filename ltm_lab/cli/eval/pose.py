"""`ltm-lab eval pose`: poses found in rendered pictures, or in a real one with control points, against the truth."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_ros.cli.output import JsonFile, writable_folder

if TYPE_CHECKING:
    from rich.table import Table

    from ltm_lab.evaluation.pose.mount_trial import MountTrial
    from ltm_lab.evaluation.pose.pose_score import PoseScore


class SkyLabels(StrEnum):
    """Where the labels come from."""

    model = "model"
    truth = "truth"


def pose(
    folders: Annotated[
        list[Path] | None,
        typer.Argument(help="Folders of `ltm-lab simulate`, such as of ltm_lab/config/scenarios/pose_*.yaml."),
    ] = None,
    engabreen: Annotated[
        Path | None, typer.Option(help="Instead: the real photo with control points, in this folder.")
    ] = None,
    sensors: Annotated[str, typer.Option(help="Poses as read from, with commas: mount, phone, no heading.")] = (
        "mount,phone,no heading"
    ),
    draws: Annotated[int, typer.Option(help="Disturbed poses of each frame and sensor.", min=1)] = 1,
    labels: Annotated[SkyLabels, typer.Option(help="Labels that the search gets.")] = SkyLabels.model,
    model: Annotated[str, typer.Option(help="Segmentation network; default: the shipped one.")] = "",
    open_views: Annotated[
        bool, typer.Option("--open", help="Without the DEM of the range around: land beyond may stand over it.")
    ] = False,
    canopy: Annotated[
        bool, typer.Option("--canopy", help="With the true surface raster instead of bare earth.")
    ] = False,
    focal: Annotated[
        float,
        typer.Option(help="Share by which focal lengths are off, either way; they are then fitted.", min=0, max=0.2),
    ] = 0.0,
    mounts: Annotated[
        bool, typer.Option("--mounts", help="Also all frames of one eye as the presets of one head, fitted together.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Of the disturbances.")] = 1,
    every: Annotated[int, typer.Option(help="Each folder's first frame and each so-manieth after it.", min=1)] = 1,
    limit: Annotated[int | None, typer.Option(help="At most so many frames of each folder.", min=1)] = None,
    pictures: Annotated[
        Path | None,
        typer.Option(help="Folder for pictures of those not accepted or off by 0.5 deg.", callback=writable_folder),
    ] = None,
    json_path: JsonFile = None,
) -> None:
    """Disturb true poses as sensors do, find them again in the pictures, and score what was found."""
    from ltm_core.base.errors import ConfigError

    if engabreen is not None:
        _real(engabreen, model, pictures, json_path)
        return
    if not folders:
        raise ConfigError("give folders of `ltm-lab simulate`, or --engabreen with the real photo's folder")
    _rendered(
        folders,
        sensors,
        draws,
        labels,
        model,
        open_views,
        canopy,
        focal,
        mounts,
        seed,
        every,
        limit,
        pictures,
        json_path,
    )


def _rendered(
    folders: list[Path],
    sensors: str,
    draws: int,
    labels: SkyLabels,
    model: str,
    open_views: bool,
    canopy: bool,
    focal: float,
    mounts: bool,
    seed: int,
    every: int,
    limit: int | None,
    pictures: Path | None,
    json_path: Path | None,
) -> None:
    from dataclasses import asdict
    from itertools import islice

    import numpy as np
    from rich.console import Console

    from ltm_core.base.errors import ConfigError, RecordingError
    from ltm_core.pictures import to_png
    from ltm_core.pictures.photo_overlays import pose_fit_picture
    from ltm_core.pose_estimation.skyline.crest_cover import CANOPY_SURFACE
    from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig, SkylineConfig
    from ltm_core.tracing import TerrainTracer
    from ltm_core.vision.manifest import DEFAULT_MODEL
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.evaluation.depth.fused_depth import upsampled_labels
    from ltm_lab.evaluation.pose.disturbance import Sensor
    from ltm_lab.evaluation.pose.mount_trial import run_mount_trial
    from ltm_lab.evaluation.pose.pose_score import PoseScore, inside, open_ones
    from ltm_lab.evaluation.pose.pose_trial import PoseTrial, PreparedFrame, prepared, run_trial
    from ltm_lab.evaluation.pose.rendered_terrain_io import rendered_terrain
    from ltm_lab.evaluation.truth_frames_io import read_truth_frames
    from ltm_ros.pages.figures_io import write_figures

    try:
        kinds = [Sensor(name.strip()) for name in sensors.split(",")]
    except ValueError as error:
        raise ConfigError(f"--sensors {sensors}: {error}; known are {', '.join(Sensor)}") from error
    console = Console()
    config = PicturePoseConfig(skyline=SkylineConfig(cover=CANOPY_SURFACE)) if canopy else PicturePoseConfig()
    segmenter = Segmenter.open(model or DEFAULT_MODEL) if labels is SkyLabels.model else None
    trials: list[PoseTrial] = []
    heads: list[MountTrial] = []
    for folder in folders:
        terrain = rendered_terrain(folder, open_views, canopy)
        tracer = TerrainTracer(terrain.dem, terrain.bend > 0, possible=terrain.possible)
        by_head: dict[str, list[PreparedFrame]] = {}
        with console.status(f"{folder.name}"):
            chosen = islice(enumerate(read_truth_frames(folder)), 0, None, every)
            for number, frame in islice(chosen, limit):
                shape = (frame.camera.height, frame.camera.width)
                ids = segmenter.segment(frame.photo).labels if segmenter else upsampled_labels(frame.labels, shape)
                ready = prepared(f"{folder.name}/{number:04d}", frame, ids, terrain, config)
                by_head.setdefault(frame.camera_name, []).append(ready)
                for kind_number, kind in enumerate(kinds):
                    rng = np.random.default_rng([seed, number, kind_number, *folder.name.encode()])
                    for draw in range(draws):
                        factor = 1.0 + focal * rng.uniform(-1, 1) if focal else 1.0
                        trial, search, _ = run_trial(ready, kind, terrain, tracer, config, rng, factor, 0.5 * focal)
                        trials.append(trial)
                        bad = not trial.accepted or abs(trial.after[0]) > 0.5
                        if pictures is not None and bad and draw == 0 and search.hypotheses:
                            lines = [("true pose", frame.camera, frame.pose)]
                            found = (
                                f"found: {trial.verdict}, azimuth {trial.after[0]:+.2f} deg off, gap {trial.gap:.1f}"
                            )
                            lines.append((found, frame.camera, search.hypotheses[0].refined.pose))
                            sheet = pose_fit_picture(frame.photo, frame.camera, search.horizon, lines)
                            name = f"{folder.name}_{number:04d}_{kind.name}.png"
                            pictures.mkdir(parents=True, exist_ok=True)
                            (pictures / name).write_bytes(to_png(sheet))
            if mounts:
                for head, frames in by_head.items():
                    rng = np.random.default_rng([seed, 977, *head.encode(), *folder.name.encode()])
                    factor = 1.0 + focal * rng.uniform(-1, 1) if focal else 1.0
                    name = f"{folder.name}/{head}"
                    heads.append(run_mount_trial(name, frames, terrain, config, rng, factor, 0.5 * focal))
    if not trials:
        raise RecordingError(f"{', '.join(map(str, folders))}: no frame with truth")
    scores = {}
    known, unknown = inside(trials), open_ones(trials)
    between = [trial for trial in trials if trial not in known and trial not in unknown]
    for place, seen in (("inside", known), ("open", unknown), ("between", between)):
        for kind in kinds:
            some = [trial for trial in seen if trial.sensor is kind]
            if some:
                scores[f"{place}, {kind}"] = PoseScore.of(some)
    console.print(_table(scores))
    if heads:
        console.print(_heads(heads))
    state = (
        f"{', '.join(f.name for f in folders)}: {len({t.frame for t in trials})} rendered frames, {draws} draws each, "
        f"labels {labels.value if segmenter is None else model or DEFAULT_MODEL}, seed {seed}"
    )
    state += f", one frame of {every}" if every > 1 else ""
    state += ", DEM of the site alone" if open_views else ", with the 10 m DEM of the range around"
    state += ", with the true surface raster" if canopy else ""
    state += f", focal lengths off by up to {focal:.0%}" if focal else ""
    console.print(f"conditions: {state}", highlight=False)
    if json_path is not None:
        content = {name: asdict(score) for name, score in scores.items()}
        report = {"conditions": state, "scores": content, "heads": [asdict(head) for head in heads]}
        write_figures(json_path, report | {"trials": [asdict(trial) for trial in trials]})


def _table(scores: dict[str, PoseScore]) -> Table:
    from rich.table import Table

    title = "errors of accepted poses: median / p90 / greatest, degrees (place: metres at about 1 km)"
    shown = Table(title=title)
    for column in ("skyline, pose from", "trials", "accepted", "azimuth", "pitch", "roll", "place", "place before"):
        shown.add_column(column, justify="left" if column.startswith("skyline") else "right")
    for column in ("off > 1, > 2", "1.48 med |z|", "CPU s"):
        shown.add_column(column, justify="right")
    for name, s in scores.items():
        shown.add_row(
            name,
            str(s.trials),
            f"{s.accepted / s.trials:.0%}",
            *(str(v) for v in (s.azimuth, s.pitch, s.roll)),
            f"{s.traced.median:.0f} / {s.traced.p90:.0f} / {s.traced.greatest:.0f}",
            f"{s.traced_before.median:.0f} / {s.traced_before.p90:.0f} / {s.traced_before.greatest:.0f}",
            f"{s.wrong_by_1}, {s.wrong_by_2}",
            " ".join(f"{z:.2f}" for z in s.z),
            f"{s.seconds.median:.2f} / {s.seconds.p90:.2f}",
        )
        if s.focal_percent.greatest > 0:
            shown.add_row("  focal length, %", "", "", str(s.focal_percent))
    return shown


def _heads(heads: list[MountTrial]) -> Table:
    import numpy as np
    from rich.table import Table

    from ltm_lab.evaluation.pose.pose_score import Spread

    shown = Table(title="heads whose presets were fitted together: errors of their pictures, degrees")
    for column in ("heads", "accepted", "azimuth", "pitch", "roll", "1.48 med |z|", "focal length, %"):
        shown.add_column(column, justify="right")
    taken = [head for head in heads if head.verdict == "accepted"]
    if taken:
        errors = np.concatenate([np.array(head.errors) for head in taken])
        z = 1.4826 * np.median(np.abs(np.concatenate([np.array(head.z) for head in taken])), axis=0)
        spreads = (str(Spread.of(errors[:, k])) for k in range(3))
        focal = str(Spread.of([100 * (head.focal - 1) for head in taken]))
        shown.add_row(str(len(heads)), str(len(taken)), *spreads, " ".join(f"{v:.2f}" for v in z), focal)
    else:
        shown.add_row(str(len(heads)), "0", "", "", "", "", "")
    return shown


def _real(folder: Path, model: str, pictures: Path | None, json_path: Path | None) -> None:
    from rich.console import Console
    from rich.table import Table

    from ltm_core.pictures import to_png
    from ltm_core.pictures.photo_overlays import pose_fit_picture
    from ltm_core.vision.manifest import DEFAULT_MODEL
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.evaluation.pose.engabreen_io import STARTS, read_real_photo, run_real_trials
    from ltm_ros.pages.figures_io import write_figures

    console = Console()
    real = read_real_photo(folder)
    ids = Segmenter.open(model or DEFAULT_MODEL).segment(real.photo).labels
    report = {}
    for name, metres, focal_free in (
        ("place and focal length of the control points", 0.0, False),
        ("focal length as stated (2.8 % off), fitted", 0.0, True),
        ("place 30 m off, fitted", 30.0, False),
    ):
        with console.status(name):
            trials = run_real_trials(real, ids, metres, focal_free)
        table = Table(title=f"{STARTS} starts, 10 deg of azimuth and 3 of pitch off; {name}")
        for column in (
            "start",
            "verdict",
            "azimuth",
            "pitch",
            "roll",
            "place, m",
            "focal",
            "RMSE, m",
            "median, m",
            "CPU s",
        ):
            table.add_column(column, justify="right")
        for t in trials:
            start, error = ("{:+.0f} {:+.0f} {:+.0f}".format(*t.start), (f"{e:+.3f}" for e in t.error))
            table.add_row(
                start, t.verdict, *error, f"{t.moved:.1f}", f"{t.focal:.4f}", f"{t.rmse:.1f}", f"{t.median:.1f}",
                f"{t.seconds:.1f}",
            )  # fmt: skip
        console.print(table)
        report[name] = [{k: v for k, v in vars(t).items() if k != "search"} for t in trials]
        if pictures is not None:
            pictures.mkdir(parents=True, exist_ok=True)
            search = trials[0].search
            lines = [("control points", real.points.camera, real.points.pose)]
            if search.hypotheses:
                lines.append((f"found: {trials[0].verdict}", real.points.camera, search.hypotheses[0].refined.pose))
            sheet = pose_fit_picture(real.photo, real.points.camera, search.horizon, lines)
            (pictures / f"engabreen_{len(report)}.png").write_bytes(to_png(sheet))
    console.print(
        "errors from the control points' pose; RMSE and median of control points on the ground that the DEM shows"
    )
    if json_path is not None:
        write_figures(json_path, report)
