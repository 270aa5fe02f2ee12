"""`ltm eval canopy`: cover and height of cells whose surface has changed, against the truth of exact scenes."""

from __future__ import annotations

from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile


def canopy(
    scenes: Annotated[str, typer.Option(help="Exact hillside scenes of `ltm eval terrain`, with commas.")] = (
        "felled,burn,growth,cut"
    ),
    seeds: Annotated[str, typer.Option(help="Of ground, plants and noise; commas.")] = "23",
    looks: Annotated[int, typer.Option(help="Images of each tower, two hours apart.", min=2)] = 4,
    region: Annotated[str, typer.Option(help="Fuel region whose constant canopy is compared.")] = "dry",
    json_path: JsonFile = None,
) -> None:
    """Median errors of the canopy as it is seen, as the older survey has it, and of the region's constant.

    What the towers measure is made, of a known surface; poses are exact.
    """
    from dataclasses import asdict

    from ltm_core.errors import ConfigError
    from ltm_core.evaluation.fuel.canopy_score import confirmed_of, score_canopy
    from ltm_core.evaluation.terrain.hillside_scenes import SceneConditions, trial
    from ltm_core.fuel.codes import FuelRegion
    from ltm_ros.evaluation.figures_io import write_figures

    try:
        numbers = [int(part) for part in seeds.split(",")]
    except ValueError as error:
        raise ConfigError(f"--seeds must be whole numbers with commas, got {seeds!r}") from error
    constant, figures = FuelRegion.named(region).canopy, []
    for name in scenes.split(","):
        for seed in numbers:
            scene = trial(name, seed)
            confirmed = confirmed_of(scene, SceneConditions(looks=looks, seed=seed))
            scores = score_canopy(scene, confirmed, constant)
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
