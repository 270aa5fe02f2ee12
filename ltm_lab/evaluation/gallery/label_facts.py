"""Measures label images of real photos against what little is known of these."""

from collections.abc import Sequence

import numpy as np

from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.scoring.labels import SegmentationScore
from ltm_core.vision.labels import Label, LabelSet
from ltm_lab.evaluation.gallery.exhibit import Fact

VEGETATION = (Label.GRASS, Label.SHRUB, Label.TREE)
_SHOWN = 0.005
"""Shares below this are left out of a list of classes."""


def called(labels: UInt8Array, where: BoolArray | None, names: Sequence[str]) -> str:
    """What the pixels (of a mask) are called, the most frequent class first: "tree 61 %, shrub 30 %"."""
    ids = labels if where is None else labels[where]
    counts = np.bincount(ids.ravel(), minlength=256)
    order = [int(k) for k in np.argsort(-counts, kind="stable") if counts[k] >= max(1, _SHOWN * ids.size)]
    return ", ".join(f"{_name(k, names)} {counts[k] / ids.size:.0%}" for k in order) or "nothing"


def share_called(labels: UInt8Array, where: BoolArray, classes: Sequence[int]) -> float:
    """Of the pixels of a mask, the share with one of `classes`; NaN of an empty mask."""
    return float(np.isin(labels[where], classes).mean()) if where.any() else float("nan")


def facts_of_areas(labels: UInt8Array, truth: UInt8Array, names: Sequence[str]) -> tuple[list[Fact], float]:
    """Facts of labels (H, W) against areas by hand (255: not named), and the share of the land in these that is wrong.

    Sky counts apart: it is most of what people name, and easy."""
    score = SegmentationScore.empty(len(names)).plus(truth, labels)
    facts = facts_of_score(score, names)
    facts += [
        Fact(f"{name} by hand ({score.true[index]:,} px) is called", called(labels, truth == index, names))
        for index, name in enumerate(names)
        if score.true[index]
    ]
    return facts, 1.0 - _land_right(score)


def facts_of_score(score: SegmentationScore, names: Sequence[str]) -> list[Fact]:
    """What of the land, and of the sky, is right, and F1 by class."""
    facts = [
        Fact("right, of the land named by hand", _land_right(score), "%"),
        Fact("right, of the sky named by hand", float(score.recall[Label.SKY]), "%"),
    ]
    facts += [Fact(f"F1 {name}", float(score.f1[k])) for k, name in enumerate(names) if score.true[k] > 0]
    return facts


def whole_picture(labels: UInt8Array, labelled: LabelSet) -> Fact:
    """What the network calls the whole picture."""
    return Fact("the picture is called", called(labels, None, labelled.names))


def _name(index: int, names: Sequence[str]) -> str:
    return names[index] if index < len(names) else "unlabelled"


def _land_right(score: SegmentationScore) -> float:
    land = np.arange(len(score.true)) != Label.SKY
    total = int(score.true[land].sum())
    return float(score.right[land].sum() / total) if total else float("nan")
