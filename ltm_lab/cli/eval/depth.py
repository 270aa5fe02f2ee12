"""`ltm-lab eval depth`: scores traced, network and fused depth against truth, by range."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ltm_ros.cli.output import JsonFile, writable_folder

if TYPE_CHECKING:
    from rich.table import Table

    from ltm_lab.evaluation.depth.fused_depth import ConditionScore

CLAIM = (
    "The paper claims for TopoDepth errors within tens of metres, and for one-shot networks one to two orders of "
    "magnitude more (mountains at 1000 m taken for tens of metres away); it gives no table."
)


class Labels(StrEnum):
    """Where the labels come from."""

    model = "model"
    truth = "truth"
    none = "none"


def depth(
    source: Annotated[
        Path | None, typer.Argument(help="Folder of `ltm-lab simulate`, or a bag with truth; default: bags/demo.")
    ] = None,
    model: Annotated[str, typer.Option(help="Depth network: manifest name or path.")] = "tcmonodepth",
    depth_maps: Annotated[
        Path | None,
        typer.Option(help="Instead of a network: a folder CAMERA/STAMP_NS.npy (.png, .tif), see depth_maps.yaml."),
    ] = None,
    labels: Annotated[Labels, typer.Option(help="Labels that the fusion gets.")] = Labels.model,
    segmentation: Annotated[str, typer.Option(help="Segmentation network; default: the site's.")] = "",
    site: Annotated[Path | None, typer.Option(help="Site file of a bag; default: beside it.")] = None,
    surface: Annotated[
        Path | None, typer.Option(help="Raster of what once stood there: traced and scored too, and given to fusion.")
    ] = None,
    date: Annotated[str, typer.Option(help="Only frames of this date of a simulated folder.")] = "",
    pose_error: Annotated[str, typer.Option(help="Also with poses wrong by so many degrees, with commas.")] = "",
    occlude: Annotated[str, typer.Option(help="Also with such shares of the photo hidden, with commas.")] = "",
    coarsen: Annotated[str, typer.Option(help="Also with DEM cells of so many metres, with commas.")] = "",
    shift: Annotated[str, typer.Option(help="Also with the DEM shifted by so many metres, with commas.")] = "",
    without: Annotated[
        list[str] | None, typer.Option(help="Also without this stage of fusion; repeatable; all: each in turn.")
    ] = None,
    limit: Annotated[int | None, typer.Option(help="Score at most so many frames.", min=1)] = None,
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for a sheet of pictures of every frame.", callback=writable_folder)
    ] = None,
    json_path: JsonFile = None,
) -> None:
    """Score traced depth, a network alone, and both fused, on the same pixels, by range of true depth."""
    import os
    import platform
    from itertools import islice

    from rich.console import Console

    from ltm_core.base.errors import RecordingError
    from ltm_core.base.resources import project_path
    from ltm_core.depth.class_priors import ClassPriors
    from ltm_core.depth.fusion_config import FusionConfig
    from ltm_core.depth.monocular import DepthNetwork, NetworkDepth
    from ltm_core.pictures import to_png
    from ltm_core.raster.dem import Dem
    from ltm_core.raster.dem_stack import with_surface
    from ltm_core.tracing.holes import NOTHING_BEYOND
    from ltm_core.vision.labels import LabelSet
    from ltm_core.vision.manifest import DEFAULT_MODEL
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.evaluation.depth.ablation import STAGES
    from ltm_lab.evaluation.depth.depth_maps_io import DepthMapFolder
    from ltm_lab.evaluation.depth.fused_depth import DepthEvaluation, Given, conditions, upsampled_labels
    from ltm_lab.evaluation.figures_io import write_figures
    from ltm_lab.evaluation.pictures.depth_sheet import depth_sheet
    from ltm_lab.evaluation.truth_frames_io import is_curved, open_dem, read_truth_frames, site_frame

    console = Console()
    stages = list(STAGES) if without == ["all"] else without or []
    place = source if source is not None else project_path("bags/demo/recording")
    name = segmentation or DEFAULT_MODEL
    if (place / "frames.json").is_file():
        dem, frames, curved = open_dem(place), read_truth_frames(place, date), is_curved(place)
        possible = NOTHING_BEYOND
        frame_of_map = site_frame(place)
    else:
        from ltm_lab.evaluation.truth_frames import recorded_truth_frames
        from ltm_ros.recordings.recorded_run import Recorded

        recorded = Recorded.find(place, site)
        name = segmentation or recorded.site.model
        dem, frames = recorded.site.open_dem(), recorded_truth_frames(place, recorded.site)
        curved, frame_of_map = recorded.site.curvature, recorded.site.frame
        possible = recorded.site.possible_ground
    over = None if surface is None else with_surface(dem, Dem.open(surface).in_frame(frame_of_map))
    network = None if depth_maps is not None else DepthNetwork.open(model)
    config = FusionConfig() if network is None else network.fusion
    classes = ClassPriors.of(LabelSet.load(), config)
    folder = None if depth_maps is None else DepthMapFolder.open(depth_maps.name, depth_maps)
    segmenter = Segmenter.open(name) if labels is Labels.model else None
    runs = [
        DepthEvaluation(condition, dem, classes, curved, over, config, possible)
        for condition in conditions(_numbers(pose_error), _numbers(occlude), _numbers(coarsen), _numbers(shift), stages)
    ]
    count = 0
    with console.status("scoring") as status:
        for frame in islice(frames, limit):
            for run in runs:
                photo, hidden = run.seen(frame)
                if network is not None:
                    estimate = network.predict(photo, frame.camera)
                else:
                    of = (frame.camera_name, frame.stamp_ns, photo.shape[:2], frame.camera)
                    values = folder.of_frame(*of) if folder is not None else None
                    if values is None or folder is None:
                        raise RecordingError(f"{depth_maps} has no depth map {frame.camera_name}/{frame.stamp_ns}.npy")
                    estimate = NetworkDepth(values, folder.config.kind)
                given = Given(estimate, None)
                if segmenter is not None:
                    given = Given(estimate, segmenter.segment(photo).labels, segmenter.manifest.label_columns)
                elif labels is Labels.truth:
                    true = upsampled_labels(frame.labels, (frame.camera.height, frame.camera.width))
                    given = Given(estimate, true, frame.labels.shape[1])
                fused, sources = run.add(frame, photo, hidden, given)
                if pictures is not None:
                    pictures.mkdir(parents=True, exist_ok=True)
                    title = f"{frame.camera_name} {frame.date} {run.condition.name}".replace("  ", " ")
                    sheet = depth_sheet(title, photo, sources, frame.surface, fused)
                    file = f"{frame.camera_name}_{frame.stamp_ns}_{run.condition.name}".replace(" ", "_")
                    (pictures / f"{file.replace(',', '').replace('%', 'percent')}.png").write_bytes(to_png(sheet))
            count += 1
            status.update(f"scored {count} frames")
    if count == 0:
        raise RecordingError(f"{place} holds no frame with photo, pose and truth: nothing can be scored")
    scores = [run.score() for run in runs]
    what = model if depth_maps is None else str(depth_maps)
    for score in scores:
        if score.condition.without:
            continue  # one line each, below
        console.print(_table(score, what))
        verdicts = ", ".join(f"{n} {verdict}" for verdict, n in sorted(score.verdicts.items()))
        covered = ", ".join(f"{key} {value:.1%}" for key, value in score.coverage.items())
        console.print(f"{verdicts}; inlier ratio {score.inlier_ratio:.2f}; true depth covered: {covered}")
    if stages:
        console.print(_ablation(scores))
    if len(scores) > 1 + len(stages):
        console.print(_verdicts([score for score in scores if not score.condition.without]))
    console.print(CLAIM)
    state = f"{place}, {count} frames, depth {what}, labels {labels.value if segmenter is None else name}"
    state += f", surface raster {surface}" if surface is not None else ""
    console.print(f"conditions: {state}; {len(os.sched_getaffinity(0))} cores, Python {platform.python_version()}")
    if json_path is not None:
        report = {"conditions": state, "claim": CLAIM, "scores": [_as_json(score) for score in scores]}
        write_figures(json_path, report)


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",") if part.strip()]
    except ValueError as error:
        raise typer.BadParameter(f"give numbers with commas, got {text!r}") from error


def _table(score: ConditionScore, network: str) -> Table:
    from rich.table import Table

    from ltm_lab.evaluation.score_tables import bin_name

    shown = Table(title=f"{score.condition.name}: metres against the visible surface, network {network}")
    for column in ("pixels that are", "source", "true depth", "pixels", "RMSE", "MAE", "median", "bias"):
        shown.add_column(column, justify="left" if column in ("pixels that are", "source") else "right")
    for group in dict.fromkeys(row.group for row in score.rows):
        for row in (r for r in score.rows if r.group == group):
            for one in (s for s in row.scores if s.pixels):
                figures = (f"{v:,.1f}" for v in (one.rmse, one.mae, one.median, one.bias))
                first = one is next(s for s in row.scores if s.pixels)
                names = (group, row.source) if first else ("", "")
                shown.add_row(*names, bin_name(one), f"{one.pixels:,}", *figures)
        shown.add_section()
    return shown


def _ablation(scores: list[ConditionScore]) -> Table:
    """RMSE of fused depth without each stage, as part of that with all: above 1, the stage gains."""
    from rich.table import Table

    groups = ("all", "open", "covered", "changed", "covered or changed")
    shown = Table(title="fused depth without one stage: RMSE over that with all stages")
    for column in ("without", *groups, "median, m", "beyond 3 sigma"):
        shown.add_column(column, justify="left" if column == "without" else "right")
    whole = scores[0]
    first = (f"{whole.rmse('fused', group):,.2f}" for group in groups)
    shown.add_row("nothing, m", *first, f"{whole.median('fused'):.2f}", f"{whole.beyond:.1%}")
    for score in scores:
        if score.condition.without:
            ratios = (score.rmse("fused", group) / whole.rmse("fused", group) for group in groups)
            honest = f"{score.median('fused'):.2f}", f"{score.beyond:.1%}"
            shown.add_row(score.condition.without, *(f"{ratio:.3f}" for ratio in ratios), *honest)
    return shown


def _verdicts(scores: list[ConditionScore]) -> Table:
    """What was said of each condition: suspicion of an exact pose is a false alarm."""
    from rich.table import Table

    shown = Table(title="verdicts by condition; suspecting the exact one is a false alarm")
    for column in ("condition", "frames", "could be checked", "pose suspected", "network unusable", "traced", "fused"):
        shown.add_column(column, justify="left" if column == "condition" else "right")
    for score in scores:
        said = (str(score.verdicts.get(verdict, 0)) for verdict in ("pose_suspected", "network_unusable"))
        errors = (f"{score.rmse(source):,.1f} m" for source in ("traced", "fused"))
        shown.add_row(score.condition.name, str(score.frames), str(score.checked), *said, *errors)
    return shown


def _as_json(score: ConditionScore) -> dict[str, Any]:
    from dataclasses import asdict
    from math import isfinite

    rows = [
        {
            "source": row.source,
            "group": row.group,
            "bins": [
                {k: v if not isinstance(v, float) or isfinite(v) else None for k, v in asdict(one).items()}
                for one in row.scores
            ],
        }
        for row in score.rows
    ]
    return {
        "condition": asdict(score.condition),
        "frames": score.frames,
        "verdicts": dict(score.verdicts),
        "checked": score.checked,
        "inlier_ratio": score.inlier_ratio,
        "beyond_three_sigmas": score.beyond,
        "coverage": dict(score.coverage),
        "rows": rows,
    }
