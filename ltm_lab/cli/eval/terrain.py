"""`ltm-lab eval terrain`: score the surface map on exact scenes, on a real site, or on simulated frames."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from ltm_lab.cli.bench.runs import print_table
from ltm_lab.options import JsonFile, writable_folder

if TYPE_CHECKING:
    from ltm_core.base.types import BoolArray
    from ltm_core.surface.layers import SurfaceLayers
    from ltm_lab.evaluation.metrics.change import ChangeScore
    from ltm_lab.evaluation.metrics.heights import SurfaceScore
    from ltm_lab.evaluation.terrain.hillside_score import Spread

HELD_OUT = "23,24,25"
"""Seeds on which no constant of the map was chosen."""
_POSE_ERROR_AND_OCCLUSION = ((0.0, 0.0), (0.5, 0.0), (2.0, 0.0), (0.0, 0.4))
"""Runs of a scene: sigma of each angle of a pose in degrees, and the share of each image that is hidden."""


def terrain(
    scenes: Annotated[str, Option(help="Scenes. Default: all.")] = "",
    seeds: Annotated[str, Option(help="Seeds of ground, plants, poses and noise.")] = HELD_OUT,
    canyon: Annotated[Path | None, Option(help="Score this folder of the real site rm22 instead.")] = None,
    frames: Annotated[Path | None, Option(help="Score this folder of `ltm-lab simulate` instead.")] = None,
    network: Annotated[
        list[str] | None, Option(help="With --canyon, --frames: also use this depth network; repeatable.")
    ] = None,
    date: Annotated[str, Option(help="With --frames: date of the truth. Default: the last.")] = "",
    looks: Annotated[int, Option(help="With --frames: how often each photo is added.", min=1)] = 1,
    watched: Annotated[
        int, Option(help="With --frames: how often the first date's photos are added before.", min=0)
    ] = 0,
    pictures: Annotated[Path | None, Option(help="Folder for an image of each run.", callback=writable_folder)] = None,
    json_path: JsonFile = None,
) -> None:
    """Compare detected change and updated surface with the truth, for two towers 500 m from a scene.

    Each scene is run with exact poses, with pose errors of 0.5 and 2 degrees, and with 40 % of each image hidden.
    Separate several scenes or seeds with commas.
    """
    from ltm_core.base.errors import ConfigError
    from ltm_lab.evaluation.terrain.hillside_scenes import SCENES
    from ltm_ros.pages import write_figures

    if canyon is not None and frames is not None:
        raise ConfigError("--canyon and --frames exclude each other; give one of them")
    if canyon is not None:
        rows = _real_site(canyon, network or [], pictures)
    elif frames is not None:
        rows = _simulated_frames(frames, date, looks, watched, network or [], pictures)
    else:
        names = scenes.split(",") if scenes else list(SCENES)
        try:
            drawn = [int(seed) for seed in seeds.split(",")]
        except ValueError as error:
            raise ConfigError(f"--seeds {seeds!r}: not whole numbers; separate seeds with commas") from error
        rows = _scenes(names, drawn, pictures)
    if json_path is not None:
        write_figures(json_path, {"rows": rows})


def _scenes(names: list[str], seeds: list[int], pictures: Path | None) -> list[dict[str, Any]]:
    from dataclasses import asdict

    from rich.console import Console

    from ltm_lab.evaluation.terrain.hillside_scenes import SceneConditions
    from ltm_lab.evaluation.terrain.hillside_score import TrialSummary, score_trial

    console, rows, figures = Console(), list[tuple[str, ...]](), list[dict[str, Any]]()
    for name in names:
        for error, hidden in _POSE_ERROR_AND_OCCLUSION:
            with console.status(f"{name}, pose error {error:g} deg, {hidden:.0%} hidden"):
                scores = [score_trial(name, SceneConditions(error, hidden, seed=seed)) for seed in seeds]
            if pictures is not None:
                place = pictures / f"{name}_{error:g}deg_{hidden:.0%}.png"
                _draw(place, scores[0].layers, scores[0].truth)
            one = TrialSummary.of(scores)
            spreads = ((one.precision, ".2f"), (one.recall, ".2f"), (one.false_share, ".2%"))
            after = ((one.rmse_before, ".2f"), (one.rmse_after, ".2f"), (one.ratio, ".2f"))
            cells = (_spread(spread, form) for spread, form in spreads + after)
            rows.append((name, f"{error:g}", f"{hidden:.0%}", str(one.changed), *cells))
            figures.append({"scene": name, "pose_error_deg": error, "occluded": hidden, "seeds": seeds, **asdict(one)})
    print_table(
        console,
        "terrain update, by cell of 1 m that independent views have seen",
        (
            "scene", "pose error deg", "hidden", "changed cells", "precision", "recall", "false of seen",
            "RMSE before m", "after m", "ratio",
        ),
        rows,
        f"mean over seeds {', '.join(map(str, seeds))}; the worst of them in brackets",
    )  # fmt: skip
    return figures


def _real_site(folder: Path, networks: list[str], pictures: Path | None) -> list[dict[str, Any]]:
    import numpy as np
    from rich.console import Console

    from ltm_core.depth.monocular import DepthNetwork
    from ltm_lab.evaluation.terrain.canyon_io import read_canyon
    from ltm_lab.evaluation.terrain.canyon_score import AFTER, BEFORE, RULES, score_canyon

    site, console, rows, figures = read_canyon(folder), Console(), list[tuple[str, ...]](), list[dict[str, Any]]()
    for network in (None, *networks):
        score = score_canyon(site, None if network is None else DepthNetwork.open(network))
        name = "each date's survey" if network is None else f"{network}: {', '.join(score.verdicts)}"
        rows.append((name, _shown(score.measured, ".1%"), *_columns(score.change, score.before, score.after)))
        figures.append(
            {"depth": name, "median_error": score.measured} | _figures(score.change, score.before, score.after)
        )
        if pictures is not None:
            _draw(pictures / f"canyon_{network or 'survey'}.png", score.layers, score.truth)
    print_table(
        console,
        f"surveys of {BEFORE} and {AFTER} (yymmdd); change: {RULES.threshold:g} m or more",
        ("depth", "median error", *_COLUMNS),
        rows,
        f"one camera with a median residual of {np.median(site.resection.residual_px):.0f} px at its control points",
    )
    return figures


def _simulated_frames(
    folder: Path, date: str, looks: int, watched: int, networks: list[str], pictures: Path | None
) -> list[dict[str, Any]]:
    from rich.console import Console

    from ltm_core.base.errors import ConfigError
    from ltm_core.depth.monocular import DepthNetwork
    from ltm_core.fuel.label_errors import known_errors
    from ltm_core.raster.dem import Dem
    from ltm_core.surface.config import TerrainConfig
    from ltm_core.vision.manifest import DEFAULT_MODEL
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.evaluation.terrain.frame_score import network_depth, score_frames, true_depth
    from ltm_lab.evaluation.terrain.hillside_scenes import Noise
    from ltm_lab.frames.truth_frames_io import dates, open_dem, read_truth_frames, site_frame

    known = dates(folder)
    if not known or (date or known[-1]) not in known:
        raise ConfigError(f"{folder}: no frames of date {date!r}; choose from {', '.join(known) or 'none'}")
    date, frame = date or known[-1], site_frame(folder)

    def raster(when: str, name: str) -> Dem:
        return Dem.open(folder / "truth" / when / f"{name}.tif").in_frame(frame)

    ground, before, now = raster(known[0], "bare_earth"), raster(known[0], "surface"), raster(date, "surface")
    rules = TerrainConfig(resolution=max(open_dem(folder).geometry.resolution / 5, before.geometry.resolution))
    exact = rules.model_copy(update={"repeated_error_share": 0.0, "alone": rules.confidence})
    segmenter, gone = Segmenter.open(DEFAULT_MODEL), known_errors(DEFAULT_MODEL).open_odds()
    measures = [("true depth", true_depth(Noise()), exact)]
    measures += [(name, network_depth(ground, before, DepthNetwork.open(name), segmenter), rules) for name in networks]
    console, rows, figures = Console(), list[tuple[str, ...]](), list[dict[str, Any]]()
    for name, measure, config in measures:
        with console.status(name):
            earlier = list(read_truth_frames(folder, known[0])) * watched if watched else []
            added = read_truth_frames(folder, date)
            score = score_frames(added, ground, before, now, measure, config, looks, gone, earlier)
        console.print(f"{name}: verdicts of the fusion: {dict(score.verdicts)}", highlight=False)
        off = (_shown(share, ".2%") for share in score.tails)
        rows.append((name, str(score.frames), *_columns(score.change, score.before, score.after), *off))
        figures.append({"depth": name, "frames": score.frames, "tails": score.tails, "verdicts": dict(score.verdicts)}
                       | _figures(score.change, score.before, score.after))  # fmt: skip
        if pictures is not None:
            _draw(pictures / f"frames_{Path(name).stem.replace(' ', '_')}.png", score.layers, score.truth)
    print_table(
        console,
        f"terrain update from frames of {date!r} on the surface of {known[0]!r}",
        ("depth", "frames", *_COLUMNS, "off by > 3 sigma", "> 5"),
        rows,
        f"cells of {rules.resolution:g} m; change: {rules.threshold:g} m or more; RMSE: changed cells that independent "
        "views have seen; off: seen cells that have not changed, by sigmas of their estimate",
    )
    return figures


_COLUMNS = ("seen cells", "changed", "precision", "recall", "false of seen", "RMSE before m", "after m")


def _columns(change: "ChangeScore", before: "SurfaceScore", after: "SurfaceScore") -> tuple[str, ...]:
    ratios = (_shown(value, ".2f") for value in (change.precision, change.recall))
    false = f"{change.false_alarms / max(change.cells, 1):.2%}"
    heights = (_shown(score.rmse, ".2f") for score in (before, after))
    return str(change.cells), str(change.hits + change.misses), *ratios, false, *heights


def _figures(change: "ChangeScore", before: "SurfaceScore", after: "SurfaceScore") -> dict[str, Any]:
    from dataclasses import asdict

    ratios = {"precision": change.precision, "recall": change.recall}
    return asdict(change) | ratios | {"rmse_before_m": before.rmse, "rmse_after_m": after.rmse}


def _draw(place: Path, layers: "SurfaceLayers", truth: "BoolArray") -> None:
    from ltm_core.pictures import to_png
    from ltm_lab.evaluation.pictures.surface_change import surface_sheet

    place.parent.mkdir(parents=True, exist_ok=True)
    shift = layers.height - layers.reference
    sheet = surface_sheet(
        layers.height, layers.sigma, shift, layers.change, layers.observed, layers.geometry, truth, 760
    )
    place.write_bytes(to_png(sheet))


def _spread(spread: "Spread", form: str) -> str:
    return f"{spread.mean:{form}} ({spread.worst:{form}})" if spread.mean == spread.mean else ""


def _shown(value: float, form: str) -> str:
    return "" if value != value else f"{value:{form}}"
