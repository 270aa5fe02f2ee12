"""`ltm-lab eval depth`: scores traced, network and fused depth against truth, by range."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ltm_lab.evaluation.depth.fused_depth import BEYOND
from ltm_lab.options import JsonFile, writable_folder

if TYPE_CHECKING:
    from ltm_core.base.types import Float32Array
    from ltm_lab.evaluation.depth.fused_depth import DepthEvaluationScore

CLAIM = (
    "The paper claims for TopoDepth errors within tens of metres, and for one-shot networks one to two orders of "
    "magnitude more (mountains at 1000 m taken for tens of metres away); it gives no table."
)


class Labels(StrEnum):
    """Where the labels come from."""

    model = "model"
    truth = "truth"
    none = "none"


class DepthMapKind(StrEnum):
    """Metres, or depth or inverse depth without scale and shift."""

    metric = "metric"
    affine_invariant = "affine_invariant"
    relative_inverse = "relative_inverse"


def depth(
    source: Annotated[
        Path | None,
        typer.Argument(
            help="Folder of `ltm-lab simulate`, `engabreen` or `grandcanyon_rm22`, or a bag with truth; default: "
            "bags/demo/recording."
        ),
    ] = None,
    networks: Annotated[str, typer.Option(help="Depth networks, separated by commas; default: the shipped one.")] = "",
    depth_maps: Annotated[
        Path | None, typer.Option(help="Folder of depth maps CAMERA/STAMP_NS.npy instead of a network.")
    ] = None,
    depth_kind: Annotated[DepthMapKind, typer.Option(help="Kind of depth in the maps.")] = DepthMapKind.metric,
    labels: Annotated[Labels, typer.Option(help="Labels that the fusion gets.")] = Labels.model,
    segmentation: Annotated[str, typer.Option(help="Segmentation network; default: the site's.")] = "",
    site: Annotated[Path | None, typer.Option(help="Site file of a bag; default: beside it.")] = None,
    surface: Annotated[
        Path | None, typer.Option(help="Raster of what once stood there: traced and scored too, and given to fusion.")
    ] = None,
    date: Annotated[str, typer.Option(help="Only frames of this date of a simulated folder.")] = "",
    pose_error: Annotated[str, typer.Option(help="Pose errors to add, in degrees, separated by commas.")] = "",
    limit: Annotated[int | None, typer.Option(help="Maximum number of frames to score.", min=1)] = None,
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
    from ltm_core.depth.fusion_config import FusionConfig
    from ltm_core.depth.ground_sampling import ClassPriors
    from ltm_core.depth.monocular import DepthNetwork, NetworkDepth
    from ltm_core.pictures import to_png
    from ltm_core.raster.dem import Dem
    from ltm_core.raster.dem_stack import with_surface
    from ltm_core.vision.labels import LabelSet
    from ltm_core.vision.manifest import DEFAULT_DEPTH_MODEL
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.cli.eval.score_table import names_in, print_table
    from ltm_lab.evaluation.depth.depth_maps_io import read_depth_map
    from ltm_lab.evaluation.depth.fused_depth import DepthEvaluation, Given, upsampled_labels
    from ltm_lab.evaluation.depth.scenes import open_scene
    from ltm_lab.evaluation.pictures.depth_sheet import depth_sheet
    from ltm_ros.pages import write_figures

    console = Console()
    place = source if source is not None else project_path("bags/demo/recording")
    scene = open_scene(place, site, date)
    over = None if surface is None else with_surface(scene.dem, Dem.open(surface).in_frame(scene.frame))
    names = [] if depth_maps is not None else names_in(networks) or [DEFAULT_DEPTH_MODEL]
    opened = {name: DepthNetwork.open(name) for name in names}
    segmenter = Segmenter.open(segmentation or scene.model) if labels is Labels.model else None
    errors = dict.fromkeys([0.0, *_numbers(pose_error)])
    runs: dict[str, list[DepthEvaluation]] = {}
    for name, config in [(key, n.fusion) for key, n in opened.items()] or [(str(depth_maps), FusionConfig())]:
        classes, beyond = ClassPriors.of(LabelSet.load(), config), scene.possible
        runs[name] = [DepthEvaluation(e, scene.dem, classes, scene.curved, over, config, beyond) for e in errors]
    count = 0
    with console.status("scoring") as status:
        for frame in islice(scene.frames, limit):
            called = None
            if segmenter is not None:
                called = segmenter.segment(frame.photo).labels
            elif labels is Labels.truth:
                called = upsampled_labels(frame.labels, (frame.camera.height, frame.camera.width))
            estimates = [network.predict(frame.photo, frame.camera) for network in opened.values()]
            if depth_maps is not None:
                values = read_depth_map(depth_maps, frame.camera_name, frame.stamp_ns, frame.photo.shape)
                estimates = [NetworkDepth(values, depth_kind.value)]
            for place_of_error, error in enumerate(errors):
                shown: dict[str, Float32Array] = {}
                for estimate, (name, own) in zip(estimates, runs.items(), strict=True):
                    sources = own[place_of_error].add(frame, Given(estimate, called))
                    shown |= sources if len(runs) == 1 else _of_network(name, sources)
                if pictures is not None:
                    pictures.mkdir(parents=True, exist_ok=True)
                    title = f"{frame.camera_name} {frame.date} pose {error:g} deg off".replace("  ", " ")
                    sheet = depth_sheet(title, frame.photo, shown, frame.surface)
                    file = f"{frame.camera_name}_{frame.stamp_ns}_pose_{error:g}_deg.png"
                    (pictures / file).write_bytes(to_png(sheet))
            count += 1
            status.update(f"scored {count} frames")
    if count == 0:
        raise RecordingError(f"{place} holds no frame with photo, pose and truth: nothing can be scored")
    scores = {name: [run.score() for run in own] for name, own in runs.items()}
    for name, of_errors in scores.items():
        for score in of_errors:
            if len(scores) == 1:
                title = f"pose {score.pose_error_deg:g} deg off: metres against the visible surface, network {name}"
                print_table(console, title, _COLUMNS, _rows(score))
            verdicts = ", ".join(f"{n} {verdict}" for verdict, n in sorted(score.verdicts.items()))
            covered = ", ".join(f"{key} {value:.1%}" for key, value in score.coverage.items())
            console.print(f"{name}: {verdicts}; inlier ratio {score.inlier_ratio:.2f}; true depth covered: {covered}")
        if len(of_errors) > 1:
            print_table(console, f"{name}: verdicts by pose error", _VERDICTS, map(_verdicts, of_errors))
    compared = [(name, of_errors[0]) for name, of_errors in scores.items()]
    print_table(console, "RMSE (median error), m, by true depth", _COMPARED, _comparison(compared), _ALIGNED)
    console.print(CLAIM)
    state = f"{place}, {count} frames, depth {', '.join(runs)}, labels "
    state += labels.value if segmenter is None else segmenter.manifest.name
    state += f", surface raster {surface}" if surface is not None else ""
    console.print(f"conditions: {state}; {len(os.sched_getaffinity(0))} cores, Python {platform.python_version()}")
    if json_path is not None:
        found = [{"network": name} | _as_json(score) for name, of_errors in scores.items() for score in of_errors]
        write_figures(json_path, {"conditions": state, "claim": CLAIM, "scores": found})


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",") if part.strip()]
    except ValueError as error:
        raise typer.BadParameter(f"give numbers with commas, got {text!r}") from error


_COLUMNS = ("pixels that are", "source", "true depth", "pixels", "RMSE", "MAE", "median", "bias")


_VERDICTS = ("pose error, deg", "frames", "checkable", "pose suspected", "network unusable", "traced", "fused")
_COMPARED = ("network", "source", "0-100 m", "100-300 m", "300-1,000 m", "> 1,000 m", "all", "beyond 100 m")
_ALIGNED = (
    "metric: the network's metres; aligned: scale (relative depth: and shift) fitted to true depth; network: fitted "
    "to the terrain, as LTM does; fused: with traced depth"
)


def _comparison(scores: "Sequence[tuple[str, DepthEvaluationScore]]") -> Iterator[tuple[str, ...]]:
    """Yield a row for each source of each network; traced depth once."""
    for number, (name, score) in enumerate(scores):
        by_group = {(row.source, row.group): row.scores for row in score.rows}
        for source in (s for s, group in by_group if group == "all" and not (number and s in ("traced", "surface"))):
            cells = [*by_group[source, "all"], *by_group.get((source, BEYOND), [])[-1:]]
            yield (name, source, *(f"{_short(c.rmse)} ({_short(c.median)})" if c.pixels else "" for c in cells))
            name = ""
        yield ()


def _of_network(name: str, sources: "Mapping[str, Float32Array]") -> "dict[str, Float32Array]":
    """Return what a picture of several networks shows of one."""
    kept = {key: depth for key, depth in sources.items() if key in ("traced", "surface")}
    return kept | {f"{name} {key}": sources[key] for key in ("aligned", "fused")}


def _short(metres: float) -> str:
    return f"{metres:,.1f}" if metres < 100 else f"{metres:,.0f}"


def _rows(score: "DepthEvaluationScore") -> Iterator[tuple[str, ...]]:
    from ltm_ros.demo.report import bin_name

    for group in dict.fromkeys(row.group for row in score.rows):
        for row in (r for r in score.rows if r.group == group):
            names = (group, row.source)
            for one in (s for s in row.scores if s.pixels):
                figures = (f"{v:,.1f}" for v in (one.rmse, one.mae, one.median, one.bias))
                yield (*names, bin_name(one), f"{one.pixels:,}", *figures)
                names = ("", "")
        yield ()


def _verdicts(score: "DepthEvaluationScore") -> tuple[object, ...]:
    said = (score.verdicts.get(verdict, 0) for verdict in ("pose_suspected", "network_unusable"))
    errors = (f"{score.rmse(source):,.1f} m" for source in ("traced", "fused"))
    return f"{score.pose_error_deg:g}", score.frames, score.checked, *said, *errors


def _as_json(score: "DepthEvaluationScore") -> dict[str, Any]:
    rows = [
        {"source": row.source, "group": row.group, "bins": [asdict(one) for one in row.scores]} for row in score.rows
    ]
    return {
        "pose_error_deg": score.pose_error_deg,
        "frames": score.frames,
        "verdicts": dict(score.verdicts),
        "checked": score.checked,
        "inlier_ratio": score.inlier_ratio,
        "beyond_three_sigmas": score.beyond,
        "coverage": dict(score.coverage),
        "rows": rows,
    }
