"""Runs the scores of `ltm-lab eval terrain` and prints and draws their results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ltm_core.base.types import BoolArray
from ltm_core.depth.monocular import DepthNetwork
from ltm_core.fuel.label_errors import LabelErrors
from ltm_core.pictures import to_png
from ltm_core.surface.config import TerrainConfig
from ltm_core.surface.layers import SurfaceLayers
from ltm_lab.bench.measure import conditions as machine
from ltm_lab.evaluation.figures_io import write_figures
from ltm_lab.evaluation.metrics.change import ChangeScore
from ltm_lab.evaluation.metrics.heights import SurfaceScore
from ltm_lab.evaluation.pictures.surface_change import surface_sheet
from ltm_lab.evaluation.terrain.hillside_scenes import SceneConditions
from ltm_lab.evaluation.terrain.hillside_score import HillsideScore, score_trial
from ltm_lab.evaluation.terrain.hillside_summary import Spread, TrialSummary

SHEET_WIDTH = 520


def scenes(
    names: Sequence[str], runs: Sequence[SceneConditions], seeds: Sequence[int], pictures: Path | None, out: Path | None
) -> None:
    """Each scene under each of `runs`, over `seeds`; a sheet of pictures of the first seed of each."""
    console, state, rules, base = Console(), machine(("numpy", "numba", "scipy")), TerrainConfig(), runs[0]
    console.print(
        f"{state.cpu}, {state.cores} cores. Two towers of 25 m, {base.width} x {base.height} at {base.hfov_deg:g} deg, "
        f"{base.looks} images each, 2 h apart; sigma {base.noise.constant:g} m + {base.noise.share:.1%} of range, half "
        f"of it correlated over {base.noise.correlation:g} px, {base.noise.lasting:.0%} of that alike in all images of "
        f"a camera; cells of 1 m; change: {rules.threshold:g} m or more. Seeds {', '.join(map(str, seeds))}: mean, and "
        "the worst of them"
    )
    table = _table(
        "terrain update by consensus, by cell, of cells that independent views have seen",
        "scene", "pose error deg", "occluded", "changed cells", "seen of them", "precision", "recall", "false of seen",
        "beside no change", "RMSE before m", "after m", "ratio",
    )  # fmt: skip
    rows: list[dict[str, Any]] = []
    with console.status("looking") as status:
        for name in names:
            for run in runs:
                scores: list[HillsideScore] = []
                for seed in seeds:
                    status.update(f"{name}, pose error {run.pose_error_deg:g} deg, {run.occluded:.0%}, seed {seed}")
                    score = score_trial(name, SceneConditions(**{**vars(run), "seed": seed}), rules)
                    rows.append(score.row())
                    if pictures is not None and not scores:
                        now, given = score.trial.true_now.elevation, score.trial.given.elevation
                        truth = np.abs(now - given) >= rules.threshold
                        place = pictures / f"{name}_{run.pose_error_deg:g}deg_{run.occluded:.0%}.png"
                        _draw(place, score.layers, truth, 760)
                    scores.append(score)
                one = TrialSummary.of(scores)
                table.add_row(
                    name,
                    f"{run.pose_error_deg:g}",
                    f"{run.occluded:.0%}",
                    f"{one.changed}",
                    _shown(one.covered, ".0%"),
                    _both(one.precision, ".2f"),
                    _both(one.recall, ".2f"),
                    _both(one.false_share, ".2%"),
                    _both(one.away_share, ".2%"),
                    _shown(one.rmse_before, ".2f"),
                    _shown(one.rmse_after, ".2f"),
                    _both(one.ratio, ".2f"),
                )
            table.add_section()
    console.print(table)
    _write(out, {"conditions": state.as_dict(), "rows": rows})


def real_site(folder: Path, networks: Sequence[str], pictures: Path | None, out: Path | None) -> None:
    """One real camera, three photos, and what the last survey says."""
    from ltm_lab.evaluation.terrain.canyon_io import read_canyon
    from ltm_lab.evaluation.terrain.canyon_score import AFTER, BEFORE, RULES, score_canyon

    site, console = read_canyon(folder), Console()
    fit = site.resection
    console.print(
        f"one camera, resected from {len(fit.points.names)} coarse control points: median residual "
        f"{np.median(fit.residual_px):.0f} px, sigma "
        + ", ".join(f"{name.removesuffix('_deg')} {value:.2f} deg" for name, value in fit.sigmas.items())
        + f". Photos of three years on the survey of {BEFORE} (yymmdd), against that of {AFTER}; change: "
        f"{RULES.threshold:g} m or more; RMSE on seen cells that have changed"
    )
    table = _table(
        "terrain update on a real sandbar",
        "depth from", "off, median", "seen cells", "changed", "precision", "recall", "RMSE before m", "after m",
        "of estimate m",
    )  # fmt: skip
    rows = []
    for network in (None, *networks):
        score = score_canyon(site, None if network is None else DepthNetwork.open(network))
        name = "each date's survey" if network is None else f"{network}: {', '.join(score.verdicts)}"
        table.add_row(
            name,
            _shown(score.measured, ".1%"),
            *_change_columns(score.change),
            _shown(score.before.rmse, ".2f"),
            _shown(score.after.rmse, ".2f"),
            _shown(score.estimate.rmse, ".2f"),
        )
        rows.append({"depth_from": name, "off_median": score.measured, "rmse_of_estimate_m": score.estimate.rmse}
                    | _figures(score.change, score.before, score.after))  # fmt: skip
        if pictures is not None:
            _draw(pictures / f"canyon_{network or 'survey'}.png", score.layers, score.truth)
    console.print(table)
    _write(out, {"rows": rows})


def simulated_frames(
    folder: Path,
    date: str,
    share: float,
    looks: int,
    watched: int,
    networks: Sequence[str],
    pictures: Path | None,
    out: Path | None,
) -> None:
    """Frames of `ltm-lab simulate` at its last or the named date, the surface of its first date given: from true depth, and
    from what each of `networks` measures in their photos, and their labels. Before them the map has looked `watched`
    times at those of the first date.
    """
    from ltm_core.base.errors import ConfigError
    from ltm_core.raster.dem import Dem
    from ltm_core.vision.manifest import DEFAULT_MODEL
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.evaluation.terrain.frame_score import network_depth, score_frames, true_depth
    from ltm_lab.evaluation.terrain.hillside_scenes import Noise
    from ltm_lab.evaluation.truth_frames_io import dates, open_dem, read_truth_frames, site_frame

    known = dates(folder)
    if not known or (date or known[-1]) not in known:
        raise ConfigError(f"{folder}: no frames of a date {date!r}; its dates are {', '.join(known) or 'none'}")
    date = date or known[-1]
    given = open_dem(folder)
    frame = site_frame(folder)

    def raster(when: str, name: str) -> Dem:
        return Dem.open(folder / "truth" / when / f"{name}.tif").in_frame(frame)

    ground, before, now = raster(known[0], "bare_earth"), raster(known[0], "surface"), raster(date, "surface")
    rules = TerrainConfig(resolution=max(given.geometry.resolution / 5, before.geometry.resolution))
    noise, console = Noise(share=share), Console()
    exact = rules.model_copy(update={"repeated_error_share": 0.0, "alone": rules.confidence})
    measures = [("true depth", true_depth(noise), exact)]
    segmenter = Segmenter.open(DEFAULT_MODEL)
    gone = LabelErrors.of_model(DEFAULT_MODEL).open_odds()
    measures += [(name, network_depth(ground, before, DepthNetwork.open(name), segmenter), rules) for name in networks]
    table = _table(
        f"terrain update from frames of {date!r} on the surface of {known[0]!r}",
        "depth from", "looks", "seen cells", "changed", "precision", "recall", "false of seen", "RMSE before m",
        "after m", "off by > 3 sigma", "> 5",
    )  # fmt: skip
    rows = []
    for name, measure, told in measures:
        with console.status(name):
            earlier = list(read_truth_frames(folder, known[0])) * watched if watched else []
            frames = read_truth_frames(folder, date)
            score = score_frames(frames, ground, before, now, measure, told, looks, gone, earlier)
        said = ", ".join(f"{verdict} {count}" for verdict, count in score.verdicts.items())
        table.add_row(
            name if name == "true depth" else f"{name}: {said}",
            str(score.frames),
            *_change_columns(score.change),
            _shown(score.change.false_alarms / max(score.change.cells, 1), ".2%"),
            _shown(score.before.rmse, ".2f"),
            _shown(score.after.rmse, ".2f"),
            *(_shown(share, ".2%") for share in score.tails),
        )
        rows.append({"depth_from": name, "tails": score.tails, "verdicts": dict(score.verdicts), "frames": score.frames}
                    | _figures(score.change, score.before, score.after))  # fmt: skip
        if pictures is not None:
            _draw(pictures / f"frames_{Path(name).stem.replace(' ', '_')}.png", score.layers, score.truth)
    console.print(table)
    before_that = f", after {watched} at those of {known[0]!r}" if watched else ""
    console.print(
        f"{folder}; cells of {rules.resolution:g} m, change: {rules.threshold:g} m or more; each photo looked at "
        f"{looks} times{before_that}, looks taken as an hour apart; true depth with sigma {noise.constant:g} m + "
        f"{share:.1%} of range, new in each look; a network's depth fitted to the terrain, "
        f"{rules.repeated_error_share:.0%} of its variance taken as alike in each look of a camera, with labels of "
        f"{segmenter.manifest.name}; "
        "exact poses; RMSE on truly changed cells that independent "
        "views have seen; off: seen cells that have not changed, of their estimate's sigma"
    )
    _write(out, {"rows": rows})


def repeated_errors(folder: Path, networks: Sequence[str]) -> None:
    """How much of the error of what a network measures is alike on all dates of a folder on which nothing changes."""
    from ltm_core.base.errors import ConfigError
    from ltm_core.raster.dem import Dem
    from ltm_core.vision.manifest import DEFAULT_MODEL
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.evaluation.terrain.frame_score import alike, network_depth
    from ltm_lab.evaluation.truth_frames_io import TruthFrame, dates, read_truth_frames, site_frame

    known, frame, console = dates(folder), site_frame(folder), Console()
    surfaces = [Dem.open(folder / "truth" / date / "surface.tif").in_frame(frame) for date in known]
    if len(known) < 2 or any(not np.array_equal(one.elevation, surfaces[0].elevation) for one in surfaces[1:]):
        raise ConfigError(f"{folder}: --alike needs photos of several dates on which nothing has changed")
    ground = Dem.open(folder / "truth" / known[0] / "bare_earth.tif").in_frame(frame)
    views: dict[str, list[TruthFrame]] = {}
    for one in read_truth_frames(folder):
        views.setdefault(f"{one.camera_name} {one.pose.angles_deg}", []).append(one)
    segmenter = Segmenter.open(DEFAULT_MODEL)
    for name in networks:
        measure = network_depth(ground, surfaces[0], DepthNetwork.open(name), segmenter)
        with console.status(name):
            share = alike(views, measure)
        console.print(
            f"{name}: {share:.1%} of the mean square of its error, in sigmas, is alike from date to date "
            f"({folder}; {', '.join(known)}; {len(views)} views)"
        )


def recorded_run(bag: Path, site: Path | None, truth: Path | None, date: str, out: Path | None) -> None:
    """What the terrain node of a recorded run had found when it ended, against the true surfaces."""
    from ltm_core.base.errors import RecordingError
    from ltm_lab.evaluation.terrain_score import score_terrain
    from ltm_ros.recordings.recorded_run import Recorded

    recorded = Recorded.find(bag, site, truth, date or None)
    now, earlier = recorded.surfaces
    if now is None:
        raise RecordingError(
            f"{recorded.truth}: no truth/DATE/surface.tif of the bag's date; name its folder with --truth, its date "
            "with --date"
        )
    score = score_terrain(recorded.bag, recorded.site, now, earlier)
    console = Console()
    table = _table(
        f"terrain of {bag}",
        "seen cells", "changed", "precision", "recall", "RMSE of found before m", "after m",
    )  # fmt: skip
    change = score.change if score.change is not None else ChangeScore(0, 0, 0, score.cells)
    table.add_row(*_change_columns(change), _shown(score.reference.rmse, ".2f"), _shown(score.updated.rmse, ".2f"))
    console.print(table)
    console.print(
        f"change: {score.threshold:g} m or more between {'no earlier date' if earlier is None else earlier} and {now}; "
        "of cells that independent views have seen; RMSE on the cells that were found changed"
    )
    _write(out, {"cells": score.cells, "threshold_m": score.threshold}
           | _figures(change, score.reference, score.updated))  # fmt: skip


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title)
    for number, name in enumerate(columns):
        table.add_column(name, justify="right" if number else "left")
    return table


def _change_columns(change: ChangeScore) -> tuple[str, str, str, str]:
    truly = change.hits + change.misses
    return str(change.cells), str(truly), _shown(change.precision, ".2f"), _shown(change.recall, ".2f")


def _figures(change: ChangeScore, before: SurfaceScore, after: SurfaceScore) -> dict[str, Any]:
    ratios = {"precision": change.precision, "recall": change.recall}
    return asdict(change) | ratios | {"rmse_before_m": before.rmse, "rmse_after_m": after.rmse}


def _draw(place: Path, layers: SurfaceLayers, truth: BoolArray, width: int = SHEET_WIDTH) -> None:
    place.parent.mkdir(parents=True, exist_ok=True)
    shift = layers.height - layers.reference
    sheet = surface_sheet(
        layers.height, layers.sigma, shift, layers.change, layers.observed, layers.geometry, truth, width
    )
    place.write_bytes(to_png(sheet))


def _write(place: Path | None, report: dict[str, Any]) -> None:
    if place is not None:
        write_figures(place, report)


def _both(spread: Spread, form: str) -> str:
    return f"{spread.mean:{form}} ({spread.worst:{form}})" if spread.mean == spread.mean else ""


def _shown(value: float, form: str) -> str:
    return "" if value != value else f"{value:{form}}"
