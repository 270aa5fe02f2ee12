"""`ltm-lab eval canopy`: cover and height of cells whose surface has changed, against the truth of exact scenes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_core.vision.manifest import DEFAULT_MODEL
from ltm_ros.cli.output import JsonFile

if TYPE_CHECKING:
    from ltm_core.fuel.codes import TreeCanopy


def canopy(
    scenes: Annotated[str, typer.Option(help="Exact hillside scenes of `ltm-lab eval terrain`, with commas.")] = (
        "felled,burn,growth,cut"
    ),
    seeds: Annotated[str, typer.Option(help="Of ground, plants and noise; commas.")] = "23",
    looks: Annotated[int, typer.Option(help="Images of each tower, two hours apart.", min=2)] = 4,
    frames: Annotated[
        list[Path] | None,
        typer.Option(help="Instead: a folder of `ltm-lab simulate`, of which trees are taken for new; repeatable."),
    ] = None,
    model: Annotated[str, typer.Option(help="With --frames: the network that labels.")] = DEFAULT_MODEL,
    depth: Annotated[
        str, typer.Option(help="With --frames: where heights come from: none, true (with noise), or a depth network.")
    ] = "none",
    climate: Annotated[str, typer.Option(help="Fuel climate whose constant canopy is compared.")] = "dry",
    json_path: JsonFile = None,
) -> None:
    """Median errors of the canopy as it is seen, as the older survey has it, and of the climate's constant.

    What the towers measure is made, of a known surface; poses are exact. With --frames, cover by a network's labels
    and heights by depth, in cells of trees of which nothing but the climate's constant is known.
    """
    from dataclasses import asdict

    from ltm_core.base.errors import ConfigError
    from ltm_core.fuel.codes import FuelClimate
    from ltm_lab.evaluation.fuel.canopy_score import confirmed_of, score_canopy
    from ltm_lab.evaluation.terrain.hillside_scenes import SceneConditions, trial
    from ltm_ros.pages.figures_io import write_figures

    try:
        numbers = [int(part) for part in seeds.split(",")]
    except ValueError as error:
        raise ConfigError(f"--seeds must be whole numbers with commas, got {seeds!r}") from error
    if depth != "none" and not frames:
        raise ConfigError(f"--depth {depth} is for rendered sites: give --frames")
    constant, figures = FuelClimate.named(climate).canopy, []
    if frames:
        rendered = [one for folder in frames for one in _rendered(folder, model, depth, looks, constant)]
        if json_path is not None:
            write_figures(json_path, {"canopy": rendered})
        return
    for name in scenes.split(","):
        for seed in numbers:
            scene = trial(name, seed)
            conditions = SceneConditions(looks=looks, seed=seed)
            scores = score_canopy(scene, confirmed_of(scene, conditions), constant, conditions)
            if not scores:
                typer.echo(f"{name}, seed {seed}: nothing was confirmed")
            for score in scores:
                typer.echo(
                    f"{name}, seed {seed}, {score.source}: cover off by {score.cover:.1f} points ({score.cells} "
                    f"cells), height by {score.height:.0%} ({score.wooded} wooded)"
                )
                figures.append({"scene": name, "seed": seed} | asdict(score))
    if json_path is not None:
        write_figures(json_path, {"canopy": figures})


def _rendered(folder: Path, model: str, depth: str, looks: int, constant: TreeCanopy) -> list[dict[str, object]]:
    """Scores of each date of a folder, which are printed."""
    from dataclasses import asdict

    from ltm_core.depth.monocular import DepthNetwork
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.evaluation.fuel.canopy_truth_io import read_canopy_truth
    from ltm_lab.evaluation.fuel.rendered_canopy import score_cover, score_heights
    from ltm_lab.evaluation.terrain.frame_score import network_depth, true_depth
    from ltm_lab.evaluation.terrain.hillside_scenes import Noise
    from ltm_lab.evaluation.truth_frames_io import dates, is_curved, open_dem, read_truth_frames

    dem, network, found = open_dem(folder), Segmenter.open(model), []
    if depth == "true":
        measure = true_depth(Noise())
    elif depth != "none":
        measure = network_depth(dem, dem, DepthNetwork.open(depth), network)
    for date in dates(folder) or [""]:
        truth, of = read_canopy_truth(folder, date), list(read_truth_frames(folder, date))
        if not of:
            continue
        scores = {"cover": score_cover(of, dem, is_curved(folder), truth, network, constant)}
        if depth != "none":
            scores["height"] = score_heights(of, dem, truth, measure, constant, looks)
        for what, score in scores.items():
            if score is None:
                typer.echo(f"{folder.name}, {date}, {what}: no cell of trees was measured")
                continue
            said = "{:.1f} points" if what == "cover" else "{:.0%}"
            typer.echo(
                f"{folder.name}, {date}, {what}: off by {said.format(score.found)} in {score.cells} cells (bias "
                f"{said.format(score.bias)}, {score.in_sigmas:.1f} sigma), "
                f"the constant by {said.format(score.constant)}"
            )
            found.append({"folder": folder.name, "date": date, "what": what} | asdict(score))
    return found
