"""Tables of a bag's scores, for the terminal and for the report, and as JSON."""

import dataclasses
import math
from typing import Any

import numpy as np

from ltm_core.base.number_text import NOTHING, percent
from ltm_lab.evaluation.run_score import BagScore
from ltm_ros.demo.report import Table, depth_table, fuel_maps_table
from ltm_ros.pages import without_nan


def tables(score: BagScore) -> list[Table]:
    """One table a part that could be scored, then what the bag lacks."""
    found = [
        depth_table(score),
        _labels(score),
        _confusion(score),
        _skylines(score),
        _fuel(score),
        fuel_maps_table(score),
        _change(score),
        _surface(score),
    ]
    found.append(_latency(score))
    kept = [table for table in found if table is not None]
    if score.lacking:
        kept.append(Table("lacking", ("part", "why"), [_split(reason) for reason in score.lacking]))
    return kept


def as_json(score: BagScore) -> dict[str, Any]:
    """Every figure by name; NaN is null."""
    labels = score.labels
    content = {
        "bag": str(score.bag),
        "site": score.site.name,
        "frames_with_truth": score.frames,
        "depth": [
            {**dataclasses.asdict(row), "scores": [dataclasses.asdict(s) for s in row.scores]} for row in score.depth
        ],
        "labels": None
        if labels is None
        else {
            "classes": list(score.class_names),
            "pixels": labels.pixels,
            "accuracy": labels.accuracy,
            "mean_iou": labels.mean_iou,
            "macro_f1": labels.macro_f1(),
            "f1": labels.f1.tolist(),
            "iou": labels.iou.tolist(),
            "precision": labels.precision.tolist(),
            "recall": labels.recall.tolist(),
            "confusion": labels.confusion.tolist(),
        },
        "skyline": {name: dataclasses.asdict(line) for name, line in score.skylines},
        "fuel": None
        if score.fuel is None
        else {
            "cells": score.fuel.cells,
            "seen": score.fuel.seen,
            "right": score.fuel.right,
            "confusion": score.fuel.confusion.tolist(),
            "right_by_majority_vote": None if score.fuel_vote is None else score.fuel_vote.right,
            "right_by_prior": None if score.fuel_prior is None else score.fuel_prior.right,
            "changes": None
            if score.fuel_changes is None
            else {
                "found": dataclasses.asdict(score.fuel_changes.found),
                "false_flips": dataclasses.asdict(score.fuel_changes.false_flips),
            },
        },
        "terrain": None if score.terrain is None else dataclasses.asdict(score.terrain),
        "latency": [dataclasses.asdict(row) for row in score.latency],
        "lacking": score.lacking,
    }
    return dict(without_nan(content))


def macro(values: np.ndarray[Any, Any], present: np.ndarray[Any, Any]) -> float:
    """The mean over the classes that occur in the truth; NaN where none does."""
    return float(values[present].mean()) if present.any() else math.nan


def _labels(score: BagScore) -> Table | None:
    labels = score.labels
    if labels is None:
        return None
    rows: list[tuple[object, ...]] = []
    for k, name in enumerate(score.class_names):
        if labels.true[k] or labels.predicted[k]:
            values = (labels.f1[k], labels.precision[k], labels.recall[k], labels.iou[k])
            rows.append((name, percent(labels.true[k] / labels.pixels), int(labels.true[k]), *map(_ratio, values)))
    present = labels.true > 0
    means = (macro(v, present) for v in (labels.f1, labels.precision, labels.recall, labels.iou))
    rows.append(("macro mean", f"right {percent(labels.accuracy)}", labels.pixels, *map(_ratio, means)))
    return Table("segmentation", ("class", "of truth", "pixels", "F1", "precision", "recall", "IoU"), rows)


def _confusion(score: BagScore) -> Table | None:
    """Shares of each true class, in percent, over the classes that occur."""
    labels = score.labels
    if labels is None:
        return None
    counts = labels.confusion
    heads = [*score.class_names, "none"]
    shown = [k for k in range(len(heads)) if counts[:, k].sum() or (k < len(counts) and counts[k].sum())]
    rows = [
        (heads[k], *(percent(counts[k, j] / counts[k].sum()) for j in shown))
        for k in range(len(counts))
        if counts[k].sum()
    ]
    return Table("confusion", ("truth ↓  label →", *(heads[j] for j in shown)), rows, "Shares of each true class.")


def _skylines(score: BagScore) -> Table | None:
    if not score.skylines:
        return None
    against = {"traced": "ground", "labels": "surface"}
    rows = [
        (name, against[name], line.columns, line.mean, line.median, line.p95, line.bias)
        for name, line in score.skylines
    ]
    step = max(line.resolution for _, line in score.skylines)
    note = (
        f"Pixels of the image; truth knows the skyline to {(step - 1) / 2:g} px. Positive bias: too low, more sky. The "
        "true one is that of all terrain; beyond the site it has no class, so only here it shows where ridges in haze "
        "are labelled sky."
    )
    columns = ("source", "against", "columns", "mean px", "median px", "p95 px", "bias px")
    return Table("skyline", columns, rows, note)


def _fuel(score: BagScore) -> Table | None:
    fuel = score.fuel
    if fuel is None:
        return None
    counts = fuel.confusion
    right, true, mapped = np.diagonal(counts), counts.sum(axis=1), counts.sum(axis=0)
    rows: list[tuple[object, ...]] = []
    present = true > 0
    with np.errstate(invalid="ignore", divide="ignore"):
        scores = [2 * right / (true + mapped), right / mapped, right / true, right / (true + mapped - right)]
    for k, name in enumerate(score.class_names[: len(counts)]):
        if true[k] or mapped[k]:
            rows.append((name, percent(true[k] / fuel.seen), int(true[k]), *(_ratio(v[k]) for v in scores)))
    share = fuel.right / fuel.seen if fuel.seen else math.nan
    means = (_ratio(macro(np.nan_to_num(v), present)) for v in scores)
    rows.append(("macro mean", f"right {percent(share)}", fuel.seen, *means))
    note = (
        f"{fuel.right:,} of the {fuel.seen:,} observed cells with a known truth are right; the map has {fuel.cells:,}."
    )
    return Table("fuel cells", ("life form", "of truth", "cells", "F1", "precision", "recall", "IoU"), rows, note)


def _change(score: BagScore) -> Table | None:
    terrain = score.terrain
    if terrain is None or terrain.change is None:
        return None
    change = terrain.change
    ratios = (change.f1, change.precision, change.recall, change.iou)
    row = ("terrain", f">= {terrain.threshold:g} m", change.cells, *map(_ratio, ratios))
    note = (
        f"{change.hits:,} of {change.hits + change.misses:,} truly changed cells found, {change.false_alarms:,} false "
        "alarms; over the cells that independent views looked at."
    )
    return Table("change", ("of", "moved by", "cells", "F1", "precision", "recall", "IoU"), [row], note)


def _surface(score: BagScore) -> Table | None:
    terrain = score.terrain
    if terrain is None or not terrain.updated.cells:
        return None
    rows = [
        (name, "changed cells", one.cells, one.rmse, one.mae, one.median, one.bias)
        for name, one in (("as updated", terrain.updated), ("reference", terrain.reference))
    ]
    return Table("surface", ("heights", "where", "cells", "RMSE m", "MAE m", "median m", "bias m"), rows)


def _latency(score: BagScore) -> Table | None:
    if not score.latency:
        return None
    rows = [(row.camera, row.topic, row.messages, row.p50_ms, row.p95_ms, row.max_ms) for row in score.latency]
    return Table(
        "latency",
        ("camera", "topic", "messages", "p50 ms", "p95 ms", "max ms"),
        rows,
        "From a frame's stamp to the moment the recorder logged the message.",
    )


def _split(reason: str) -> tuple[str, str]:
    part, _, why = reason.partition(": ")
    return part, why


def _ratio(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else NOTHING


def shown(value: object) -> str:
    """A cell of a table as people write it."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        return str(value)
    if not math.isfinite(value):
        return NOTHING
    if isinstance(value, int | np.integer):
        return f"{value:,}"
    number = float(value)
    return f"{number:,.2f}" if abs(number) < 1000 else f"{number:,.0f}"
