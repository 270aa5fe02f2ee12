"""Fits the log odds of fusion to rendered frames, by logistic regression."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel
from scipy.optimize import minimize
from scipy.special import expit

from ltm_core.base.errors import ModelError
from ltm_core.base.types import Float64Array
from ltm_core.depth.fusion_config import FusionConfig
from ltm_lab.training.fusion_samples import CLASSES, FrameSamples, Samples

STANDING = (*(f"occlusion.standing.{name}" for name in CLASSES), "occlusion.metre", "decision.likelihood_weight")
CANOPY = (*(f"decision.canopy.{name}" for name in CLASSES), "decision.canopy_weight")
_POSITIVE = (
    "occlusion.metre",
    "decision.likelihood_weight",
    "decision.canopy_weight",
)
LEAST = 500
"""Samples below which a choice keeps its constants."""
_BELIEF = 1.0
"""Belief in the constants as they were, as of a sigma of 1: a class that is hardly seen keeps them."""


@dataclass(frozen=True)
class FusionFit:
    """`config`: with the fitted constants. `counts`: samples by choice. `loss`: mean negative log likelihood by choice,
    before and after, on frames of folders that were left out of the fit in turn."""

    config: FusionConfig
    counts: Mapping[str, int]
    loss: Mapping[str, tuple[float, float]]


def fit_fusion(folders: Sequence[Sequence[FrameSamples]], config: FusionConfig) -> FusionFit:
    """Fit all choices to the frames of several folders; each frame counts alike. Raises ModelError without samples."""
    changes: dict[str, Any] = {}
    counts, loss = {}, {}
    for choice, names in (("standing", STANDING), ("canopy", CANOPY)):
        sets = [[getattr(frame, choice) for frame in folder] for folder in folders]
        start = np.array([reduce(getattr, name.split("."), config) for name in names])
        everything = [samples for folder in sets for samples in folder if len(samples.right)]
        counts[choice] = sum(len(samples.right) for samples in everything)
        if counts[choice] < LEAST:
            continue
        fitted = _regress(everything, start, names)
        changes |= {name: round(float(value), 2) for name, value in zip(names, fitted, strict=True)}
        loss[choice] = _left_out(sets, start, names)
    if not changes:
        raise ModelError(
            f"the frames hold too few pixels to choose on: {counts}; at least {LEAST} of a kind are needed"
        )
    return FusionFit(updated(config, changes), counts, loss)


def updated(config: FusionConfig, changes: Mapping[str, Any]) -> FusionConfig:
    """Return a copy with other values by dotted name; all types and bounds are checked. Raises ValueError."""
    content = config.model_dump()
    for name, value in changes.items():
        *path, last = name.split(".")
        place = content
        for part in path:
            place = place[part]
        place[last] = value
    return FusionConfig.model_validate(content)


def constants(model: BaseModel, prefix: str = "") -> Iterator[tuple[str, Any, str, str]]:
    """Iterate over dotted name, value, origin and meaning of every constant."""
    for name, info in type(model).model_fields.items():
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            yield from constants(value, f"{prefix}{name}.")
        else:
            extra = info.json_schema_extra
            assert isinstance(extra, dict)
            yield f"{prefix}{name}", value, str(extra["origin"]), info.description or ""


def write_fusion_config(path: Path, config: FusionConfig, source: str) -> None:
    """Write the fitted constants with their meaning. `source`: how they were fitted, in words."""
    lines = [f"# Constants of depth fusion (ltm_core/depth/fusion_config.py), fitted by: {source}"]
    before: list[str] = []
    fitted = (one for one in constants(config) if one[2] == "fitted")
    for group, members in groupby(fitted, key=lambda c: c[0].rpartition(".")[0]):
        parts = group.split(".")
        shared = sum(1 for a, b in zip(before, parts, strict=False) if a == b)
        lines += [f"{'  ' * depth}{parts[depth]}:" for depth in range(shared, len(parts))]
        before = parts
        for name, value, _, meaning in members:
            text = f"{'  ' * len(parts)}{name.rpartition('.')[2]}: {json.dumps(value)}"
            lines.append(f"{text:<28} # {meaning}")
    if path.is_symlink():  # to another network's: that one keeps its own
        path.unlink()
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _regress(frames: Sequence[Samples], start: Float64Array, names: Sequence[str]) -> Float64Array:
    """Weights by penalised maximum likelihood; frames weigh alike, as much as a middling one has samples."""
    features = np.concatenate([frame.features for frame in frames])
    offset = np.concatenate([frame.offset for frame in frames])
    right = np.concatenate([frame.right for frame in frames]).astype(np.float64)
    middling = float(np.median([len(frame.right) for frame in frames]))
    weight = np.concatenate([np.full(len(frame.right), middling / len(frame.right)) for frame in frames])

    def cost(w: Float64Array) -> tuple[float, Float64Array]:
        odds = features @ w + offset
        value = float((weight * (np.logaddexp(0.0, odds) - right * odds)).sum())
        gradient = features.T @ (weight * (expit(odds) - right))
        return value + 0.5 * _BELIEF * float(((w - start) ** 2).sum()), gradient + _BELIEF * (w - start)

    bounds = [(0.0, None) if name in _POSITIVE else (-8.0, 8.0) for name in names]
    return np.asarray(minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds).x, np.float64)


def _left_out(folders: Sequence[Sequence[Samples]], start: Float64Array, names: Sequence[str]) -> tuple[float, float]:
    """Mean loss of frames under the constants as they were, and as fitted to the other folders."""
    before, after = [], []
    for i, folder in enumerate(folders):
        others = [s for k, rest in enumerate(folders) if k != i for s in rest if len(s.right)]
        if not others:
            continue
        fitted = _regress(others, start, names)
        for samples in folder:
            if len(samples.right):
                before.append(_loss(samples, start))
                after.append(_loss(samples, fitted))
    return (float(np.mean(before)), float(np.mean(after))) if before else (float("nan"), float("nan"))


def _loss(samples: Samples, weights: Float64Array) -> float:
    odds = samples.features @ weights + samples.offset
    return float(np.mean(np.logaddexp(0.0, odds) - samples.right * odds))
