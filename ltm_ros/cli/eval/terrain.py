"""`ltm eval terrain`: what the surface map finds on exact scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def terrain(
    scenes: Annotated[str, typer.Option(help="Scenes, with commas; empty: all of them.")] = "",
    pose_errors: Annotated[
        str, typer.Option(help="Degrees by which each angle of a pose is off, sigma; with commas.")
    ] = "0,0.5,2",
    occluded: Annotated[str, typer.Option(help="Shares of each image that something nearer hides; commas.")] = "0,0.4",
    looks: Annotated[int, typer.Option(help="Images of each tower, two hours apart.", min=1)] = 3,
    share: Annotated[float, typer.Option(help="Sigma of the measured depth as a share of range.", min=0)] = 0.01,
    canyon: Annotated[
        Path | None,
        typer.Option(help="Instead: the real site rm22 of sandbar_seg, with later surveys, in this folder."),
    ] = None,
    network: Annotated[str, typer.Option(help="Depth network for the real site's photos; empty: none.")] = "",
    pictures: Annotated[Path | None, typer.Option(help="Folder for a sheet of pictures of each run.")] = None,
    json_path: Annotated[Path | None, typer.Option("--json", help="Also write every figure to this file.")] = None,
) -> None:
    """Change and surface from two towers against the truth, by scene, pose error and occlusion.

    Scenes stand 500 m from the towers. Pose errors are run without occlusion, occlusion with exact poses.
    """
    if canyon is not None:
        _real(canyon, network, pictures, json_path)
        return
    import json
    from dataclasses import replace

    from rich.console import Console
    from rich.table import Table

    from ltm_core.bench.measure import conditions as machine
    from ltm_core.errors import ConfigError
    from ltm_core.pictures import to_png
    from ltm_core.pictures.surface import surface_sheet
    from ltm_core.site import TerrainConfig
    from ltm_core.terrain.trial_score import score_trial
    from ltm_core.terrain.trials import SCENES, Conditions, Noise

    def numbers(text: str, name: str, most: float) -> list[float]:
        try:
            values = [float(part) for part in text.split(",")]
        except ValueError as error:
            raise ConfigError(f"--{name} must be numbers with commas, got {text!r}") from error
        if not all(0 <= value <= most for value in values):
            raise ConfigError(f"--{name} must lie between 0 and {most:g}, got {text!r}")
        return values

    console = Console()
    names = scenes.split(",") if scenes else list(SCENES)
    base = Conditions(looks=looks, noise=Noise(share=share))
    runs = [replace(base, pose_error_deg=error) for error in numbers(pose_errors, "pose-errors", 10)]
    runs += [replace(base, occluded=part) for part in numbers(occluded, "occluded", 0.9) if part > 0]
    rules, state = TerrainConfig(), machine(("numpy", "numba", "scipy"))
    console.print(
        f"{state.cpu}, {state.cores} cores. Two towers of 25 m, {base.width} x {base.height} at {base.hfov_deg:g} deg, "
        f"{looks} images each, 2 h apart; sigma {base.noise.constant:g} m + {share:.1%} of range, half of it "
        f"correlated over {base.noise.correlation:g} px, {base.noise.lasting:.0%} of that alike in all images of a "
        f"camera; cells of 1 m; change: {rules.threshold:g} m or more; seed {base.seed}"
    )
    table = Table(title="terrain update by consensus, by cell, of cells that independent views have seen")
    for name in (
        "scene", "pose error deg", "occluded", "changed cells", "seen of them", "precision", "recall", "false of seen",
        "RMSE before m", "after m",
    ):  # fmt: skip
        table.add_column(name, justify="left" if name == "scene" else "right")
    rows = []
    with console.status("looking") as status:
        for name in names:
            for run in runs:
                status.update(f"{name}, pose error {run.pose_error_deg:g} deg, {run.occluded:.0%} occluded")
                score = score_trial(name, run, rules)
                rows.append(score.row())
                change = score.change
                truly = change.hits + change.misses
                table.add_row(
                    name,
                    f"{run.pose_error_deg:g}",
                    f"{run.occluded:.0%}",
                    f"{truly}",
                    _shown(score.covered, ".0%"),
                    _shown(change.precision, ".2f"),
                    _shown(change.recall, ".2f"),
                    f"{score.false_share:.2%}",
                    _shown(score.rmse_before, ".2f"),
                    _shown(score.rmse_after, ".2f"),
                )
                if pictures is not None:
                    pictures.mkdir(parents=True, exist_ok=True)
                    layers = score.layers
                    truth = abs(score.trial.true_now.elevation - score.trial.given.elevation) >= rules.threshold
                    sheet = surface_sheet(
                        layers.height,
                        layers.sigma,
                        layers.height - layers.reference,
                        layers.change,
                        layers.observed,
                        layers.geometry,
                        truth,
                    )
                    place = pictures / f"{name}_{run.pose_error_deg:g}deg_{run.occluded:.0%}.png"
                    place.write_bytes(to_png(sheet))
            table.add_section()
    console.print(table)
    if json_path is not None:
        json_path.parent.mkdir(parents=True, exist_ok=True)
        report = {"conditions": state.as_dict(), "rows": rows}
        json_path.write_text(json.dumps(report, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _shown(value: float, form: str) -> str:
    return "" if value != value else f"{value:{form}}"


def _real(folder: Path, network: str, pictures: Path | None, json_path: Path | None) -> None:
    """One real camera, three photos, and what the last survey says."""
    import json

    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from ltm_core.depth.classes import DepthClasses
    from ltm_core.depth.monocular import DepthNetwork
    from ltm_core.pictures import to_png
    from ltm_core.pictures.surface import surface_sheet
    from ltm_core.resources import config_path
    from ltm_core.terrain.canyon_io import read_canyon
    from ltm_core.terrain.canyon_score import AFTER, BEFORE, RULES, score_canyon
    from ltm_core.vision.labels import LabelSet

    site = read_canyon(folder)
    classes = DepthClasses.of(LabelSet.load(config_path("labels.yaml")))
    fit = site.resection
    console = Console()
    console.print(
        f"one camera, resected from {len(fit.points.names)} coarse control points: median residual "
        f"{np.median(fit.residual_px):.0f} px, sigma "
        + ", ".join(f"{name.removesuffix('_deg')} {value:.2f} deg" for name, value in fit.sigmas.items())
        + f". Photos of three years on the survey of {BEFORE} (yymmdd), against that of {AFTER}; change: "
        f"{RULES.threshold:g} m or more; RMSE on seen cells that have changed"
    )
    table = Table(title="terrain update on a real sandbar")
    for name in (
        "depth from", "off, median", "seen cells", "precision", "recall", "RMSE before m", "after m", "of estimate m",
    ):  # fmt: skip
        table.add_column(name, justify="left" if name == "depth from" else "right")
    scores = [score_canyon(site, None, classes)]
    if network:
        scores.append(score_canyon(site, DepthNetwork.open(network), classes))
    rows = []
    for score in scores:
        name = "each date's survey" if score.name == "ideal depth" else f"{network}: {', '.join(score.verdicts)}"
        figures = {
            "off_median": score.measured,
            "seen_cells": score.change.cells,
            "precision": score.change.precision,
            "recall": score.change.recall,
            "rmse_before_m": score.before.rmse,
            "rmse_after_m": score.after.rmse,
            "rmse_of_estimate_m": score.estimate.rmse,
        }
        forms = (".1%", "d", ".2f", ".2f", ".2f", ".2f", ".2f")
        table.add_row(name, *(_shown(value, form) for value, form in zip(figures.values(), forms, strict=True)))
        rows.append({"depth_from": name} | {k: None if v != v else v for k, v in figures.items()})
        if pictures is not None:
            pictures.mkdir(parents=True, exist_ok=True)
            layers = score.layers
            sheet = surface_sheet(
                layers.height,
                layers.sigma,
                layers.height - layers.reference,
                layers.change,
                layers.observed,
                layers.geometry,
                score.truth,
                width=520,
            )
            (pictures / f"canyon_{score.name.split()[0]}.png").write_bytes(to_png(sheet))
    console.print(table)
    if json_path is not None:
        json_path.parent.mkdir(parents=True, exist_ok=True)
        json_path.write_text(json.dumps({"rows": rows}, indent=2, allow_nan=False) + "\n", encoding="utf-8")
