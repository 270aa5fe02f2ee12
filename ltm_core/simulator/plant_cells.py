"""Square cells of the ground as plants find them: what the land cover says of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ltm_core.simulator.landcover import SHRUB, TREE, LandCover

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Cells:
    """Square cells of the ground, (N,) each, and what the land cover says of them: `shares` (N, 5) by class."""

    x: Array
    y: Array
    side: float
    shares: Array
    density: Array
    shrub_height: Array
    tree_height: Array
    char: Array
    scorch: Array
    dead_shrub: Mask
    dead_tree: Mask
    rock: Array
    conifer: Mask
    rubble: Mask
    edge: Mask  # a change has ended inside the cell


def describe(cover: LandCover, x: Array, y: Array, side: float, samples: int = 3) -> Cells:
    """Shares of each class over square cells, from samples x samples points, and the stand at their centres."""
    stand = cover.stand
    steps = (np.arange(samples) - (samples - 1) / 2) * side / samples
    shares = np.zeros((len(x), 5))
    touched = cover.sample(stand.touched, x, y)
    edge = np.zeros(len(x), bool)
    for dx in steps:
        for dy in steps:
            shares[np.arange(len(x)), np.minimum(cover.at(x + dx, y + dy), 4)] += 1 / samples**2
            edge |= cover.sample(stand.touched, x + dx, y + dy) != touched
    names = ("density", "shrub_height", "tree_height", "char", "scorch", "rock")
    here = {n: np.asarray(cover.sample(getattr(stand, n), x, y), np.float64) for n in names}
    dead = cover.sample(stand.dead, x, y)
    conifer = cover.sample(stand.conifer, x, y) >= 0.5
    rubble = cover.sample(stand.rubble, x, y) >= 0.5
    return Cells(
        x, y, side, shares, dead_shrub=dead == SHRUB, dead_tree=dead == TREE, conifer=conifer,
        rubble=rubble, edge=edge, **here,
    )  # fmt: skip
