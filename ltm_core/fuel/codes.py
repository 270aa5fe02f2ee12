"""Define the standard fuel models with their colours, the codes of changed cells, and the crosswalk to FBFM13.

Scott and Burgan (2005, RMRS-GTR-153) relate their models to Anderson's (1982) within the fuel type that carries the
fire: grass to models 1 to 3, shrub to 4 to 7, timber to 8 to 10, slash to 11 to 13, and grass with shrubs to either of
the first two. Which model within the type is no function of the code: LANDFIRE derives both maps from vegetation. So a
table gives it for a climate, and a map that has both systems gives its own pairs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import Final

import numpy as np
from pydantic import Field

from ltm_core.base.errors import ConfigError
from ltm_core.base.resources import config_path
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import BoolArray, Int16Array, Int64Array, UInt8Array
from ltm_core.fuel.life_form import NODATA, NONBURNABLE, LifeForm
from ltm_core.fuel.stand_allometry import ForestType
from ltm_core.storage.config_io import load_yaml
from ltm_core.storage.disk_io import is_file

CUSTOM: Final = range(14, 90)
"""Codes that both systems reserve for custom fuel models (Scott and Burgan 2005, table 3)."""
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
"""Minimum number of cells with a code in maps of both systems to learn its partner there."""


def partners(code: int) -> range:
    """Return the FBFM13 models of the fuel type of an FBFM40 code; empty for a code that is no burnable model."""
    return next((group for codes, group in _TYPES.items() if code in codes), range(0))


def of_one_fuel_type(fbfm40: Int16Array, fbfm13: Int16Array) -> BoolArray:
    """Return whether two maps of the same ground agree on the fuel type that carries the fire.

    What does not burn agrees with such alone. True also where either has no fuel type that is known: NODATA, an
    analyst's own model, a code that no system has."""
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
    """Return whether a code is a custom fuel model: it has no table entry, and no label changes it."""
    return (codes >= CUSTOM.start) & (codes < CUSTOM.stop)


@dataclass(frozen=True, eq=False)
class Crosswalk:
    """Map from FBFM40 to FBFM13. `open_ground`: (256,) int16 partner of each code, NODATA none. `under_trees`: the same
    where tree cover is at least `least_cover` (256,) %."""

    open_ground: Int16Array
    under_trees: Int16Array
    least_cover: Int16Array

    @classmethod
    def of(cls, table: Mapping[int, int], under_trees: Mapping[int, tuple[int, int]]) -> Crosswalk:
        """Return the crosswalk of a table; `under_trees`: code -> (minimum cover in %, partner). Non-burnable and
        custom codes do not change."""
        plain = _lookup(table)
        shaded, least = plain.copy(), np.full(256, 101, np.int16)
        for code, (cover, partner) in under_trees.items():
            shaded[code], least[code] = partner, cover
        return cls(plain, shaded, least)

    def to_fbfm13(self, codes: Int16Array, cover: Int16Array | None = None) -> Int16Array:
        """Convert (H, W) FBFM40 codes; invalid codes become NODATA. `cover`: of trees, %, NODATA if unknown."""
        index = _index(codes)
        shaded = np.zeros(codes.shape, np.bool_) if cover is None else cover >= self.least_cover[index]
        return np.where(shaded, self.under_trees[index], self.open_ground[index])

    def learned(self, fbfm40: Int16Array, fbfm13: Int16Array, cover: Int16Array | None = None) -> Crosswalk:
        """Return a copy with the most common partners, of the same fuel type, in a map of both systems."""
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
    """Return (256,) what each code becomes; non-burnable and custom ones stay, of the others those of no table are
    NODATA."""
    lookup = np.full(256, NODATA, np.int16)
    for code in (*NONBURNABLE, *CUSTOM):
        lookup[code] = code
    lookup[list(table)] = list(table.values())
    return lookup


def _index(codes: Int16Array) -> Int16Array:
    """Return the places in a table; 0, which is no code, for what lies outside it."""
    return np.where((codes >= 0) & (codes < 256), codes, 0).astype(np.int16)


def to_fbfm40(table: Mapping[int, int], codes: Int16Array) -> Int16Array:
    """Convert FBFM13 codes to FBFM40 by a table; non-burnable and custom codes do not change, unknown ones become
    NODATA."""
    return np.asarray(_lookup(table)[_index(codes)], np.int16)


class FuelSystem(StrEnum):
    """The code systems of surface fuel models."""

    FBFM13 = "fbfm13"
    """Anderson (1982)."""
    FBFM40 = "fbfm40"
    """Scott and Burgan (2005)."""


class FuelModel(StrictModel):
    """One burnable fuel model, in its publication's units (see `config/fuel/fuel_models.yaml`)."""

    name: str
    description: str
    depth: float = Field(gt=0)
    """Depth of the fuel bed in feet."""
    extinction: float = Field(gt=0)
    """Dead fuel moisture of extinction in %."""
    load: tuple[float, float, float, float, float]
    """Fuel load in short tons per acre: 1 h, 10 h, 100 h, live herbaceous, live woody."""
    sav: tuple[float | None, float | None, float | None]
    """Surface-to-volume ratio in 1/ft: 1 h, live herbaceous, live woody fuel."""
    heat: float = Field(default=8000.0, gt=0)
    """Heat content in Btu/lb."""


class NonburnableModel(StrictModel):
    name: str
    description: str


class FuelModels(StrictModel):
    """All fuel models by code."""

    fbfm13: dict[int, FuelModel]
    fbfm40: dict[int, FuelModel]
    nonburnable: dict[int, NonburnableModel]

    def name(self, code: int) -> str:
        """Return a name such as GR2, FM4 or NB9; the number itself for an invalid code."""
        for table in (self.fbfm40, self.fbfm13, self.nonburnable):
            if code in table:
                return str(table[code].name)
        return str(code)

    def codes(self, system: FuelSystem) -> frozenset[int]:
        """Return the codes of a system, non-burnable ones included."""
        return frozenset({FuelSystem.FBFM13: self.fbfm13, FuelSystem.FBFM40: self.fbfm40}[system]) | frozenset(
            self.nonburnable
        )


@lru_cache(maxsize=1)
def fuel_models() -> FuelModels:
    """Return the tables that ship with the project. Raises ConfigError if their file is damaged."""
    return load_yaml(config_path("fuel/fuel_models.yaml"), FuelModels)


def system_of_codes(codes: Int16Array) -> FuelSystem:
    """Return the system of a map (H, W) that does not state it: FBFM13 if all its burnable standard models belong to
    it."""
    models = fuel_models()
    burnable = codes[np.isin(codes, [*models.fbfm13, *models.fbfm40])]
    return FuelSystem.FBFM13 if len(burnable) and (burnable <= max(models.fbfm13)).all() else FuelSystem.FBFM40


class ChangedCodes(StrictModel):
    """Code of a cell whose life form differs from the prior's, or without a prior."""

    grass: int
    grass_shrub: int
    """Code for cells in which both have more than 30 % of the evidence."""
    shrub: int
    shrubs_to_tree: int
    """Code for trees where the prior has shrubs."""
    to_tree: int
    """Code for trees where the prior has no woody plants."""
    bare: int
    water: int
    built: int
    burned: int
    regrowth: int
    """Code after `burned_days`."""

    def of(self, form: Int64Array, over_shrubs: BoolArray) -> Int16Array:
        """Return (...) the codes of cells now of a life form (`form`: its id - 1). `over_shrubs`: where the prior has
        shrubs."""
        table = [self.grass, self.shrub, self.to_tree, self.bare, self.water, self.built, self.burned]
        trees = (form == LifeForm.TREE - 1) & over_shrubs
        return np.where(trees, self.shrubs_to_tree, np.array(table)[form]).astype(np.int16)


class TreeCanopy(StrictModel):
    """Canopy of a new tree cell. `cover`: %. Heights in metres, `bulk_density` kg/m3."""

    cover: float = Field(ge=0, le=100)
    height: float = Field(ge=0)
    base_height: float = Field(ge=0)
    bulk_density: float = Field(ge=0)


class ChangedBySystem(StrictModel):
    fbfm40: ChangedCodes
    fbfm13: ChangedCodes


class FuelClimate(StrictModel):
    """Meaning of fuel codes in a climate: see `config/fuel/climates`."""

    description: str
    changed: ChangedBySystem
    canopy: TreeCanopy
    forest: ForestType = ForestType.MIXED_CONIFER
    """Forest type whose allometry gives crown base height and bulk density from cover and height."""
    crosswalk: dict[int, int]
    """Map from every burnable FBFM40 code to FBFM13, within its fuel type."""
    under_trees: dict[int, tuple[int, int]] = Field(default_factory=dict)
    """Map from FBFM40 to (minimum tree cover in %, FBFM13) for codes with a different partner under trees."""
    crosswalk_back: dict[int, int]
    """Map from every burnable FBFM13 code to FBFM40, within its fuel type."""

    @classmethod
    def named(cls, name: str) -> FuelClimate:
        """Return a climate that ships with the project. Raises ConfigError with the list of names."""
        folder = config_path("fuel/climates")
        path = folder / f"{name}.yaml"
        if not is_file(path):
            there = ", ".join(sorted(p.stem for p in folder.glob("*.yaml")))
            raise ConfigError(f"unknown fuel climate {name!r}; choose from {there}")
        return load_yaml(path, cls)

    def as_crosswalk(self) -> Crosswalk:
        """Return the map from FBFM40 to FBFM13 for maps that do not have both."""
        return Crosswalk.of(self.crosswalk, self.under_trees)

    def changed_codes(self, codes: Int16Array, system: FuelSystem, to: FuelSystem) -> Int16Array:
        """Return (...) codes of changed cells in the other system: those of `changed` for the same cover; NODATA for
        codes that `changed` does not list."""
        own, other = getattr(self.changed, system).model_dump(), getattr(self.changed, to).model_dump()
        found = np.full(codes.shape, NODATA, np.int16)
        # Covers that share a code in one system do not in the other: what is named first is the commoner.
        for key in reversed(own):
            found[codes == own[key]] = other[key]
        return found


Color = tuple[int, int, int]

_LANDFIRE: Final[dict[int, Color]] = {
    91: (104, 104, 104), 93: (255, 237, 237), 98: (0, 14, 214), 99: (77, 110, 112),
    101: (255, 235, 190), 102: (255, 211, 115), 103: (255, 236, 139), 106: (230, 230, 64),
    121: (255, 170, 0), 122: (255, 167, 127), 123: (255, 99, 0),
    141: (215, 194, 158), 142: (215, 176, 158), 143: (205, 137, 102), 144: (137, 90, 68), 146: (237, 112, 68),
    161: (233, 255, 190), 162: (170, 255, 0), 163: (180, 215, 158), 165: (38, 115, 0),
    181: (190, 255, 232), 182: (0, 255, 197), 183: (190, 210, 255), 184: (123, 104, 238), 185: (190, 232, 255),
    186: (0, 197, 255), 188: (0, 92, 230), 189: (77, 110, 145),
    2: (255, 255, 0), 3: (230, 197, 11), 5: (255, 170, 102), 7: (137, 112, 68), 8: (211, 255, 190), 9: (112, 168, 0),
    10: (38, 115, 0),
}  # fmt: skip
"""Colours of the attribute tables of LANDFIRE 2022 (from a tile of Vermont, which has these codes)."""
_OURS: Final[dict[int, Color]] = {
    92: (225, 240, 255), 104: (240, 200, 60), 105: (215, 190, 90), 107: (200, 170, 20), 108: (180, 150, 60),
    109: (150, 125, 20), 124: (200, 60, 20), 145: (176, 74, 40), 147: (150, 40, 40), 148: (110, 60, 40),
    149: (80, 35, 30), 164: (115, 160, 80), 187: (60, 150, 190),
    201: (230, 190, 255), 202: (200, 120, 220), 203: (160, 60, 190), 204: (110, 0, 140),
    1: (255, 255, 190), 4: (168, 56, 0), 6: (255, 127, 80), 11: (230, 190, 255), 12: (180, 90, 210), 13: (110, 0, 140),
}  # fmt: skip
"""Colours of codes that this tile lacks, similar to those of their group."""
_UNKNOWN: Final[Color] = (222, 222, 220)


def code_color(code: int) -> Color:
    """Return the colour of a fuel code of either system; grey where it is none."""
    return _LANDFIRE.get(code) or _OURS.get(code) or _UNKNOWN


def code_colors(codes: Int16Array) -> UInt8Array:
    """Return (..., 3) colours of codes (...)."""
    table = np.array([code_color(code) for code in range(256)], np.uint8)
    return table[np.where((codes >= 0) & (codes < 256), codes, 0)]


def code_names(codes: Int16Array) -> list[tuple[str, Color]]:
    """Return the name and colour of each code that occurs, the commonest first."""
    found, counts = np.unique(codes[codes != NODATA], return_counts=True)
    return [(fuel_models().name(int(code)), code_color(int(code))) for code in found[np.argsort(-counts)]]
