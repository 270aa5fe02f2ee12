"""Square ground cells in which plants are placed, with the shares of land cover classes in each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltm_core.base.types import BoolArray, Float64Array
from ltm_lab.simulator.landcover import SHRUB, TREE, LandCover


@dataclass(frozen=True)
class PlantCells:
    """Square cells of the ground, (N,) each, and what the land cover says of them: `shares` (N, 5) by class."""

    x: Float64Array
    y: Float64Array
    side: float
    shares: Float64Array
    density: Float64Array
    shrub_height: Float64Array
    tree_height: Float64Array
    char: Float64Array
    scorch: Float64Array
    dead_shrub: BoolArray
    dead_tree: BoolArray
    rock: Float64Array
    conifer: BoolArray
    rubble: BoolArray
    edge: BoolArray  # a change has ended inside the cell


def describe(cover: LandCover, x: Float64Array, y: Float64Array, side: float, samples: int = 3) -> PlantCells:
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
    return PlantCells(
        x, y, side, shares, dead_shrub=dead == SHRUB, dead_tree=dead == TREE, conifer=conifer,
        rubble=rubble, edge=edge, **here,
    )  # fmt: skip
