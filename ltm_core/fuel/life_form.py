"""Define life forms (grass, shrub, tree, bare), and terrain without them: plants on rock walls, water on slopes.

A pixel that shows one there is a network's error: it does not vote, for this form or another."""

from collections.abc import Sequence
from enum import IntEnum
from typing import Final

import numpy as np

from ltm_core.base.types import BoolArray, Float64Array, Int16Array, Int64Array, UInt8Array, UInt16Array, UInt32Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.vision.labels import LabelSet


class LifeForm(IntEnum):
    """Dominant cover of a cell. Ids up to BUILT are those of the labels of the same names."""

    GRASS = 1
    SHRUB = 2
    TREE = 3
    BARE = 4
    WATER = 5
    BUILT = 6
    BURNED = 7


FORMS: Final = len(LifeForm)
"""Life forms; arrays over them are indexed by the form's id - 1."""
BURNED_COLOR: Final = (15, 10, 10)
NODATA: Final = -9999
"""Nodata value of fuel codes and canopy bands."""
NONBURNABLE: Final = (91, 92, 93, 98, 99)
_GRASS, _SHRUB, _TREE, _BARE = LifeForm.GRASS, LifeForm.SHRUB, LifeForm.TREE, LifeForm.BARE
_GROUPS: Final[tuple[tuple[range, tuple[LifeForm, ...]], ...]] = (
    (range(1, 4), (_GRASS,)), (range(4, 8), (_SHRUB,)), (range(8, 11), (_TREE,)),
    (range(91, 92), (LifeForm.BUILT,)), (range(92, 93), (_BARE,)), (range(93, 94), (_GRASS, _BARE)),
    (range(98, 99), (LifeForm.WATER,)), (range(99, 100), (_BARE,)),
    (range(101, 110), (_GRASS,)), (range(121, 125), (_GRASS, _SHRUB)), (range(141, 150), (_SHRUB,)),
    (range(161, 166), (_TREE,)), (range(181, 190), (_TREE,)),
    # Slash: no camera tells it from what it lies among.
    (range(11, 14), (_SHRUB, _TREE, _BARE)), (range(201, 205), (_SHRUB, _TREE, _BARE)),
)  # fmt: skip
FORMS_OF_CODE: Final = np.zeros((256, FORMS), np.bool_)
"""(256, FORMS) bool: life forms that agree with a fuel code of either system; a row without any is not a code."""
for _codes, _forms in _GROUPS:
    FORMS_OF_CODE[np.ix_(_codes, [form - 1 for form in _forms])] = True


def forms_of(codes: Int16Array) -> BoolArray:
    """Return (..., FORMS) the life forms that agree with each fuel code; none for unknown codes and nodata."""
    known = (codes >= 0) & (codes < len(FORMS_OF_CODE))
    return np.asarray(FORMS_OF_CODE[np.where(known, codes, 0)], np.bool_)


def held(codes: Int16Array, mask: Sequence[int]) -> BoolArray:
    """Return (...) whether a cell with this prior code never changes by labels: codes of `mask` (`FusionRules.mask`),
    and codes of no known form (custom models, or codes the prior keeps)."""
    unknown = ~forms_of(codes).any(axis=-1) & (codes != NODATA)
    return np.asarray(np.isin(codes, mask) | unknown, np.bool_)


def label_forms(labels: LabelSet) -> Int64Array:
    """Return (K,) index of each label's life form, -1 for labels that are none: sky, and classes of other names."""
    indices = {form.name.lower(): form - 1 for form in LifeForm}
    covers = zip(labels.names, labels.ground_cover, strict=True)
    return np.array([indices.get(name, -1) if cover else -1 for name, cover in covers], np.int64)


def form_counts(counts: UInt32Array, forms: Int64Array) -> Float64Array:
    """Return (N, FORMS) pixels of each life form, of (N, K) pixels of each label; `forms` as of `label_forms`."""
    table = np.zeros((len(forms), FORMS))
    of_form = np.flatnonzero(forms >= 0)
    table[of_form, forms[of_form]] = 1.0
    return counts.astype(np.float64) @ table  # whole numbers: exact


def life_form_labels(labels: LabelSet) -> LabelSet:
    """Return the names and colours of the map's classes: life forms have the ids of the labels of their names; burned
    has none."""
    shown = LifeForm.BURNED
    return LabelSet(
        names=(*labels.names[:shown], shown.name.lower()),
        colors=(*labels.colors[:shown], BURNED_COLOR),
        ground_cover=(*labels.ground_cover[:shown], True),
    )


PARTS = 4
"""Number of parts per side of a fuel cell, 7.5 m for a cell of 30 m. The terrain is checked for each part."""
_PLANTS = (LifeForm.GRASS, LifeForm.SHRUB, LifeForm.TREE)
WATER_STEEPEST_DEG: Final = 10.0
"""Slope in degrees over the width of a fuel cell above which water labels are ignored. Of LANDFIRE's water cells in
Vermont, at Tubbs and in the Santa Ana Mountains, 0.4 to 6.6 % are steeper, nearly all on banks (at most 0.3 % of those
amid water). Of the land there, 40 to 63 % is steeper."""
_BIT = np.uint16(1) << np.arange(PARTS * PARTS, dtype=np.uint16).reshape(PARTS, PARTS)


class GroundLimits:
    """Parts of the fuel grid's cells that are too steep: for plants above `steepest_deg` (None: no limit), for water
    above WATER_STEEPEST_DEG. The terrain is read once per cell, when a frame first sees it. `masks`: (2, H, W) uint16,
    a bit for each of a cell's PARTS x PARTS parts, row by row from the north-west: where no plant is believed, and
    where no water. `kinds`: (256,) uint8 by label id: 1 for plants, 2 for water, each as soon as its mask has a bit; 0
    for all else."""

    def __init__(self, steepest_deg: float | None, geometry: GridGeometry, dem: Dem, labels: LabelSet) -> None:
        self._steepest_deg, self._geometry, self._dem = steepest_deg, geometry, dem
        # calloc'ed: cells that no frame sees take no memory.
        self._known = np.zeros(geometry.shape, np.bool_)
        self.masks: UInt16Array = np.zeros((2, *geometry.shape), np.uint16)
        self.kinds: UInt8Array = np.zeros(256, np.uint8)
        forms = label_forms(labels)
        limited = _PLANTS, (LifeForm.WATER,)
        self._labels = [np.flatnonzero(np.isin(forms, [form - 1 for form in some])) for some in limited]

    def learn(self, cells: Int64Array) -> BoolArray:
        """Read the terrain of those of the cells, (N,) row * width + col, that are new; return (256,) the labels that
        have a limit in one of these."""
        new = cells[~self._known.ravel()[cells]]
        masks = self._beyond(new)
        self.masks.reshape(2, -1)[:, new] = masks
        self._known.ravel()[new] = True
        found = np.zeros(256, np.bool_)
        for kind, labels in enumerate(self._labels, start=1):
            if masks[kind - 1].any():
                found[labels] = True
                self.kinds[labels] = kind
        return found

    def _beyond(self, cells: Int64Array) -> UInt16Array:
        """Return (2, N) masks of cells, by the terrain at the middles of each cell's parts and half a cell about it."""
        row, col = np.divmod(cells, self._geometry.width)
        offset = (np.arange(2 * PARTS) + 0.5) / PARTS - 1.0  # cells from the cell's middle
        places = np.broadcast_arrays(row[:, None, None] + offset[:, None], col[:, None, None] + offset)
        heights = self._dem.elevation_at(*self._geometry.to_map(*places))
        inner = slice(PARTS // 2, PARTS // 2 + PARTS)
        east = heights[:, inner, PARTS:] - heights[:, inner, :PARTS]
        south = heights[:, PARTS:, inner] - heights[:, :PARTS, inner]
        slope = np.degrees(np.arctan(np.hypot(east, south) / self._geometry.resolution))
        # A height that is not known is no limit: comparisons with NaN are false.
        limits = np.inf if self._steepest_deg is None else self._steepest_deg, WATER_STEEPEST_DEG
        return np.stack([np.where(slope > most, _BIT, 0).sum(axis=(1, 2), dtype=np.uint16) for most in limits])
