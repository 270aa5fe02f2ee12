"""Life forms (grass, shrub, tree, ...): what a camera can tell of a fuel cell, and their relation to fuel codes."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Final

import numpy as np

from ltm_core.base.types import BoolArray, Float64Array, Int16Array, Int64Array, UInt32Array
from ltm_core.vision.labels import LabelSet


class LifeForm(IntEnum):
    """The cover that a cell is mostly of. Ids up to BUILT are those of the labels of the same names."""

    GRASS = 1
    SHRUB = 2
    TREE = 3
    BARE = 4
    WATER = 5
    BUILT = 6
    BURNED = 7


FORMS: Final = len(LifeForm)
"""Arrays over life forms have the form's id - 1 as index."""
BURNED_COLOR: Final = (45, 35, 35)
NODATA: Final = -9999
"""Of fuel codes and canopy bands: nothing is known."""
NONBURNABLE: Final = (91, 92, 93, 98, 99)
_GRASS, _SHRUB, _TREE, _BARE = LifeForm.GRASS, LifeForm.SHRUB, LifeForm.TREE, LifeForm.BARE
_GROUPS: Final[tuple[tuple[range, tuple[LifeForm, ...]], ...]] = (
    (range(1, 4), (_GRASS,)),
    (range(4, 8), (_SHRUB,)),
    (range(8, 11), (_TREE,)),
    (range(11, 14), (_SHRUB, _TREE, _BARE)),
    (range(91, 92), (LifeForm.BUILT,)),
    (range(92, 93), (_BARE,)),
    (range(93, 94), (_GRASS, _BARE)),
    (range(98, 99), (LifeForm.WATER,)),
    (range(99, 100), (_BARE,)),
    (range(101, 110), (_GRASS,)),
    (range(121, 125), (_GRASS, _SHRUB)),
    (range(141, 150), (_SHRUB,)),
    (range(161, 166), (_TREE,)),
    (range(181, 190), (_TREE,)),
    (range(201, 205), (_SHRUB, _TREE, _BARE)),  # slash: no camera tells it from what it lies among
)


def _table() -> BoolArray:
    table = np.zeros((256, FORMS), np.bool_)
    for codes, forms in _GROUPS:
        for form in forms:
            table[list(codes), form - 1] = True
    return table


FORMS_OF_CODE: Final = _table()
"""(256, FORMS) bool: the life forms that agree with a fuel code, of either system. No form: no such code."""


def forms_of(codes: Int16Array) -> BoolArray:
    """(..., FORMS): the life forms that agree with each fuel code; none for unknown codes and nodata."""
    known = (codes >= 0) & (codes < len(FORMS_OF_CODE))
    return np.asarray(FORMS_OF_CODE[np.where(known, codes, 0)], np.bool_)


def held(codes: Int16Array, mask: Sequence[int]) -> BoolArray:
    """(...) where nothing that is seen changes a cell of these prior codes: codes of `mask` (`FusionRules.mask`), and
    those of no known form, an analyst's own models or what the prior was told to keep."""
    unknown = ~forms_of(codes).any(axis=-1) & (codes != NODATA)
    return np.asarray(np.isin(codes, mask) | unknown, np.bool_)


def label_forms(labels: LabelSet) -> Int64Array:
    """(K,) index of each label's life form, -1 for labels that are none: sky, and classes of other names."""
    indices = {form.name.lower(): form - 1 for form in LifeForm}
    covers = zip(labels.names, labels.ground_cover, strict=True)
    return np.array([indices.get(name, -1) if cover else -1 for name, cover in covers], np.int64)


def form_counts(counts: UInt32Array, forms: Int64Array) -> Float64Array:
    """(N, FORMS) pixels of each life form, of (N, K) pixels of each label; `forms` as of `label_forms`."""
    table = np.zeros((len(forms), FORMS))
    of_form = np.flatnonzero(forms >= 0)
    table[of_form, forms[of_form]] = 1.0
    return counts.astype(np.float64) @ table  # whole numbers: exact


def life_form_labels(labels: LabelSet) -> LabelSet:
    """Names and colours of the map's classes: life forms have the ids of the labels of their names; burned has none."""
    shown = LifeForm.BURNED
    return LabelSet(
        names=(*labels.names[:shown], shown.name.lower()),
        colors=(*labels.colors[:shown], BURNED_COLOR),
        ground_cover=(*labels.ground_cover[:shown], True),
    )
