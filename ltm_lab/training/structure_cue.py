"""Teaches a finished network what is built, by structures drawn into photos: masts, huts, dishes, roofs.

Nothing else of the network changes. Its coarser decoder maps tell such things from land, where the last one, which its
answers are read from, does not: so they get a say in the score of `built` alone, a linear one, as logistic regression
fits it. Labelled photos of towers' own parts are hardly to be had; drawn ones are true to the pixel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from pydantic import Field
from scipy import optimize, special

from ltm_core.base.errors import ImageError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float64Array
from ltm_core.vision.labels import Label
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.training.decoder_maps import SIDES
from ltm_lab.training.head_fit import class_weights
from ltm_lab.training.head_samples import PhotoSamples, photo_samples
from ltm_lab.training.labelled_frames import Frame
from ltm_lab.training.structures import with_structures

_LEAST_SPREAD: Final = 1e-3
_STEPS: Final = 300


class CueConfig(StrictModel):
    """How the say is taught. `draws`: copies of each photo with structures drawn, beside the photo as it is; `pixels`:
    of one class in one copy. `rarity`: a class counts in a copy as its area's share to this power. `ridge`: penalty on
    the squares of the weights, of features brought to unit spread. `rarity` and `ridge` were chosen on photos held
    out: real buildings among trees, and drawn structures in mountains."""

    draws: int = Field(default=4, ge=1)
    pixels: int = Field(default=150, ge=1)
    rarity: float = Field(default=0.5, ge=0, le=1)
    ridge: float = Field(default=1e-4, ge=0)
    seed: int = 0


class StructureCue(NamedTuple):
    """What is added to the score of `built`: `weights` (C,) of each map in SIDES, and `bias`."""

    weights: Mapping[str, Float64Array]
    bias: float


def cue_samples(segmenter: Segmenter, frames: Sequence[Frame], config: CueConfig) -> list[PhotoSamples]:
    """Pixels of the photos, and of copies with structures drawn into them."""
    rng, samples = np.random.default_rng(config.seed), []
    for frame in frames:
        copies = [frame]
        for _ in range(config.draws):
            photo, labels = with_structures(frame.image.astype(np.float32) / 255.0, frame.labels, rng)
            copies.append(Frame(np.round(photo * 255.0).astype(np.uint8), labels, frame.path))
        samples += [photo_samples(segmenter, each, frame.path.stem, rng, config.pixels) for each in copies]
    return samples


def fit_cue(samples: Sequence[PhotoSamples], channels: Mapping[str, int], config: CueConfig) -> StructureCue:
    """The say that explains best what is built, beside the network's own scores, under the ridge.

    `channels`: those of each map, in the order of the samples' features. Raises ImageError where nothing is built, or
    all is.
    """
    built = np.concatenate([s.labels for s in samples]) == Label.BUILT if samples else np.empty(0, bool)
    if not built.any() or built.all():
        raise ImageError("no pixel of anything built, or of nothing else: name areas of land in the photos first")
    starts = dict(zip(channels, np.cumsum([0, *channels.values()]), strict=False))
    columns = np.concatenate([np.arange(starts[name], starts[name] + channels[name]) for name in SIDES])
    features = np.concatenate([s.features[:, columns] for s in samples])
    # of the odds against all other classes, which stay as they are
    own = np.concatenate(
        [s.scores[:, Label.BUILT] - special.logsumexp(np.delete(s.scores, Label.BUILT, 1), axis=1) for s in samples]
    )
    weight = np.concatenate([w / w.sum() for w in (class_weights(s, config.rarity) for s in samples) if len(w)])
    weight /= weight.sum()
    mean, spread = features.mean(axis=0), features.std(axis=0) + _LEAST_SPREAD
    inputs = (features - mean) / spread

    def cost(values: Float64Array) -> tuple[float, Float64Array]:
        odds = own + inputs @ values[:-1] + values[-1]
        loss = (weight * (np.logaddexp(0.0, odds) - built * odds)).sum()
        slope = weight * (special.expit(odds) - built)
        ridge = config.ridge * values[:-1]
        return float(loss + 0.5 * (ridge * values[:-1]).sum()), np.append(inputs.T @ slope + ridge, slope.sum())

    start = np.zeros(len(columns) + 1)
    best = optimize.minimize(cost, start, jac=True, method="L-BFGS-B", options={"maxiter": _STEPS}).x
    taught = best[:-1] / spread
    parts = np.split(taught, np.cumsum([channels[name] for name in SIDES])[:-1])
    return StructureCue(dict(zip(SIDES, parts, strict=True)), float(best[-1] - mean @ taught))
