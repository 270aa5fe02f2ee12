"""How far what grows on a crest stands over the DEM, by its label and how far away it is.

Labels of far crests are the more often wrong, so that heights by them draw together and spread.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.vision.labels import Label

_NEAR, _FAR = 250.0, 1500.0
"""Metres; between them by the logarithm of the range."""


class CoverHeights(StrictModel):
    """Metres by which a crest of each class stands over the DEM, and their standard deviation."""

    tree: tuple[float, float]
    shrub: tuple[float, float]
    grass: tuple[float, float]
    bare: tuple[float, float]
    other: tuple[float, float]

    def table(self) -> Float64Array:
        """(256, 2) metres by label: how high, and its sigma."""
        table = np.tile(np.array(self.other), (256, 1))
        for label, values in ((Label.TREE, self.tree), (Label.SHRUB, self.shrub), (Label.GRASS, self.grass)):
            table[label] = values
        table[[Label.BARE, Label.WATER]] = self.bare
        return table


class CrestCover(StrictModel):
    """Of crests up to 250 m away, and from 1500 m on."""

    near: CoverHeights
    far: CoverHeights

    def of(self, labels: UInt8Array) -> Float64Array:
        """(N, 4) of labels (N,): near height and sigma, far height and sigma."""
        return np.asarray(_table(self)[labels], np.float64)

    def at(self, labels: UInt8Array, ranges: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Heights and sigmas (N,) of crests with these labels at these ranges (N,), metres."""
        both, far = self.of(labels), farness(ranges)
        height, sigma = ((1 - far) * both[:, k] + far * both[:, k + 2] for k in (0, 1))
        return height, sigma


@lru_cache(maxsize=8)
def _table(cover: CrestCover) -> Float64Array:
    """(256, 4) by label: a search asks for it hundreds of times."""
    return np.column_stack([cover.near.table(), cover.far.table()])


def farness(ranges: Float64Array) -> Float64Array:
    """0 up to 250 m, 1 from 1500 m on."""
    return np.asarray(np.clip(np.log(np.maximum(ranges, 1.0) / _NEAR) / np.log(_FAR / _NEAR), 0.0, 1.0), np.float64)


def everywhere(heights: CoverHeights) -> CrestCover:
    """The same at all ranges."""
    return CrestCover(near=heights, far=heights)


BARE_EARTH = CrestCover(
    near=CoverHeights(tree=(5.5, 5.2), shrub=(0.7, 0.8), grass=(0.2, 0.4), bare=(0.1, 0.3), other=(1.0, 2.0)),
    far=CoverHeights(tree=(1.8, 2.9), shrub=(1.5, 2.0), grass=(0.3, 0.4), bare=(0.2, 0.4), other=(1.0, 2.0)),
)
"""Over a DEM of bare earth; by maximum likelihood on `tower_k` to `tower_n`, 192 rendered views, true poses."""
CANOPY_SURFACE = everywhere(
    CoverHeights(tree=(0.0, 1.0), shrub=(0.0, 0.5), grass=(0.1, 0.3), bare=(0.1, 0.3), other=(0.0, 1.0))
)
"""For a DEM that holds the tops of the canopy already."""
