"""Relates the two systems of fuel models, FBFM40 and FBFM13, within the fuel type that carries the fire.

Scott and Burgan (2005, RMRS-GTR-153) order their models by the fuel type that carries the fire, and relate them to
Anderson's (1982) within that type: grass to models 1 to 3, shrub to 4 to 7, timber to 8 to 10, slash to 11 to 13, and
grass with shrubs to either of the first two. Which model within the type is no function of the code: LANDFIRE derives
both maps from vegetation. So a table gives it for a region, may tell cells under trees from open ones, and gives way to
a map's own pairs where it has both systems.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from ltm_core.fuel.life_form import NODATA, NONBURNABLE
from ltm_core.types import BoolArray, Int16Array

CUSTOM: Final = range(14, 90)
"""Numbers that both systems leave to an analyst's own fuel models (Scott and Burgan 2005, table 3)."""
_GRASS, _SHRUB, _TIMBER, _SLASH = range(1, 4), range(4, 8), range(8, 11), range(11, 14)
_TYPES: Final[Mapping[range, range]] = {
    range(101, 110): _GRASS,
    range(121, 125): range(1, 8),
    range(141, 150): _SHRUB,
    range(161, 166): _TIMBER,
    range(181, 190): _TIMBER,
    range(201, 205): _SLASH,
}
_ENOUGH_PAIRS: Final = 20
"""Cells of a code in a map of both systems, to learn its partner there."""


def partners(code: int) -> range:
    """The FBFM13 models of the fuel type of an FBFM40 code; empty for a code that is no burnable model."""
    return next((group for codes, group in _TYPES.items() if code in codes), range(0))


def of_one_fuel_type(fbfm40: Int16Array, fbfm13: Int16Array) -> BoolArray:
    """Where two maps of the same ground agree on the fuel type that carries the fire.

    What does not burn agrees with such alone. True also where either has no fuel type that is known: NODATA, an
    analyst's own model, a code that no system has.
    """
    agree = np.ones((256, 256), np.bool_)
    burnable = range(_GRASS.start, _SLASH.stop)
    agree[np.ix_(list(NONBURNABLE), burnable)] = False
    for code in range(256):
        if own := partners(code):
            agree[code, [*burnable, *NONBURNABLE]] = False
            agree[code, own] = True
    same: BoolArray = agree[_index(fbfm40), _index(fbfm13)]
    return same


def is_custom(codes: Int16Array) -> BoolArray:
    """Where a code is an analyst's own fuel model: no table knows it, and no label changes it."""
    return (codes >= CUSTOM.start) & (codes < CUSTOM.stop)


@dataclass(frozen=True, eq=False)
class Crosswalk:
    """FBFM40 -> FBFM13. `open_ground`: (256,) int16 partner of each code, NODATA none. `under_trees`: the same where
    tree cover is `least_cover` (256,) % or more.
    """

    open_ground: Int16Array
    under_trees: Int16Array
    least_cover: Int16Array

    @classmethod
    def of(cls, table: Mapping[int, int], under_trees: Mapping[int, tuple[int, int]]) -> Crosswalk:
        """`under_trees`: code -> (least cover in %, partner). Non-burnable and custom codes stay what they are."""
        plain = _lookup(table)
        shaded, least = plain.copy(), np.full(256, 101, np.int16)
        for code, (cover, partner) in under_trees.items():
            shaded[code], least[code] = partner, cover
        return cls(plain, shaded, least)

    def to_fbfm13(self, codes: Int16Array, cover: Int16Array | None = None) -> Int16Array:
        """(H, W) of FBFM40 codes; codes that are none become NODATA. `cover`: of trees, %, NODATA where unknown."""
        index = _index(codes)
        shaded = np.zeros(codes.shape, np.bool_) if cover is None else cover >= self.least_cover[index]
        return np.where(shaded, self.under_trees[index], self.open_ground[index])

    def learned(self, fbfm40: Int16Array, fbfm13: Int16Array, cover: Int16Array | None = None) -> Crosswalk:
        """With the commonest partners, of the same fuel type, that a map of both systems has itself."""
        shaded = np.zeros(fbfm40.shape, np.bool_) if cover is None else cover >= self.least_cover[_index(fbfm40)]
        tables = self.open_ground.copy(), self.under_trees.copy()
        for code in np.unique(fbfm40).tolist():
            own = (fbfm40 == code) & np.isin(fbfm13, list(partners(code)))
            for table, there in zip(tables, (own & ~shaded, own & shaded), strict=True):
                if there.sum() >= _ENOUGH_PAIRS:
                    values, counts = np.unique(fbfm13[there], return_counts=True)
                    table[code] = values[counts.argmax()]
        return Crosswalk(*tables, self.least_cover)


def _lookup(table: Mapping[int, int]) -> Int16Array:
    """(256,) what each code becomes; non-burnable and custom ones stay, of the others those of no table are NODATA."""
    lookup = np.full(256, NODATA, np.int16)
    for code in (*NONBURNABLE, *CUSTOM):
        lookup[code] = code
    lookup[list(table)] = list(table.values())
    return lookup


def _index(codes: Int16Array) -> Int16Array:
    """Places in a table; 0, which is no code, for what lies outside it."""
    return np.where((codes >= 0) & (codes < 256), codes, 0).astype(np.int16)


def to_fbfm40(table: Mapping[int, int], codes: Int16Array) -> Int16Array:
    """FBFM13 codes as FBFM40 by a table; non-burnable and custom codes stay, unknown ones become NODATA."""
    return np.asarray(_lookup(table)[_index(codes)], np.int16)
