"""Define the standard fuel models with their colours, the codes of changed cells, and the crosswalk to FBFM13.

Scott and Burgan (2005, RMRS-GTR-153) relate their models to Anderson's (1982) within the fuel type that carries the
fire: grass to models 1 to 3, shrub to 4 to 7, timber to 8 to 10, slash to 11 to 13, and grass with shrubs to either of
the first two. Which model within the type is no function of the code: LANDFIRE derives both maps from vegetation. So a
table gives it for a climate."""

from collections.abc import Mapping
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
from ltm_core.storage.config_io import load_yaml
from ltm_core.storage.disk_io import is_file

Color = tuple[int, int, int]
CUSTOM: Final = range(14, 90)
"""Codes that both systems reserve for custom fuel models (Scott and Burgan 2005, table 3); no label changes them."""
_GRASS, _SHRUB, _TIMBER, _SLASH = range(1, 4), range(4, 8), range(8, 11), range(11, 14)
FUEL_TYPES: Final[Mapping[range, range]] = {
    range(101, 110): _GRASS,
    range(121, 125): range(1, 8),
    range(141, 150): _SHRUB,
    range(161, 166): _TIMBER,
    range(181, 190): _TIMBER,
    range(201, 205): _SLASH,
}
"""FBFM13 models of the fuel types of FBFM40 codes."""


def of_one_fuel_type(fbfm40: Int16Array, fbfm13: Int16Array) -> BoolArray:
    """Return whether two maps of the same ground agree on the fuel type that carries the fire. What does not burn
    agrees with such alone. True also where either has no fuel type that is known: NODATA, an analyst's own model, a
    code that no system has."""
    agree, burnable = np.ones((256, 256), np.bool_), range(_GRASS.start, _SLASH.stop)
    agree[np.ix_(list(NONBURNABLE), burnable)] = False
    for own, others in FUEL_TYPES.items():
        agree[np.ix_(own, [*burnable, *NONBURNABLE])] = False
        agree[np.ix_(own, others)] = True
    return np.asarray(agree[_index(fbfm40), _index(fbfm13)])


def _index(codes: Int16Array) -> Int16Array:
    """Return the places in a table; 0, which is no code, for what lies outside it."""
    return np.where((codes >= 0) & (codes < 256), codes, 0).astype(np.int16)


class FuelSystem(StrEnum):
    """The code systems of surface fuel models."""

    FBFM13 = "fbfm13"
    """Anderson (1982)."""
    FBFM40 = "fbfm40"
    """Scott and Burgan (2005)."""


class FuelModel(StrictModel):
    name: str
    description: str
    color: Color


class FuelModels(StrictModel):
    """All fuel models by code."""

    fbfm13: dict[int, FuelModel]
    fbfm40: dict[int, FuelModel]
    nonburnable: dict[int, FuelModel]

    def find(self, code: int) -> FuelModel | None:
        """Return the model of a code; None for an invalid code."""
        return self.fbfm40.get(code) or self.fbfm13.get(code) or self.nonburnable.get(code)

    def name(self, code: int) -> str:
        """Return a name such as GR2, FM4 or NB9; the number itself for an invalid code."""
        return str(code) if (known := self.find(code)) is None else known.name

    def codes(self, system: FuelSystem) -> frozenset[int]:
        """Return the codes of a system, non-burnable ones included."""
        own = self.fbfm13 if system is FuelSystem.FBFM13 else self.fbfm40
        return frozenset((*own, *self.nonburnable))


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


class ForestType(StrEnum):
    DOUGLAS_FIR = "douglas_fir"
    PONDEROSA_PINE = "ponderosa_pine"
    LODGEPOLE_PINE = "lodgepole_pine"
    MIXED_CONIFER = "mixed_conifer"


class TreeCanopy(StrictModel):
    """Canopy of a new tree cell. `cover`: %. Heights in metres, `bulk_density` kg/m3."""

    cover: float = Field(ge=0, le=100)
    height: float = Field(ge=0)
    base_height: float = Field(ge=0)
    bulk_density: float = Field(ge=0)


class FuelClimate(StrictModel):
    """Meaning of fuel codes in a climate: see `config/fuel/climates`."""

    description: str
    changed: dict[FuelSystem, ChangedCodes] = Field(min_length=len(FuelSystem))
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
    def named(cls, name: str) -> "FuelClimate":
        """Return a climate that ships with the project. Raises ConfigError with the list of names."""
        folder = config_path("fuel/climates")
        path = folder / f"{name}.yaml"
        if not is_file(path):
            there = ", ".join(sorted(p.stem for p in folder.glob("*.yaml")))
            raise ConfigError(f"unknown fuel climate {name!r}; choose from {there}")
        return load_yaml(path, cls)

    def crossed(self, codes: Int16Array, to: FuelSystem, cover: Int16Array | None = None) -> Int16Array:
        """Convert (H, W) codes of the other system by the crosswalk; non-burnable and custom codes stay, unknown ones
        become NODATA. `cover`: of trees, %, NODATA if unknown."""
        lookup = np.full(256, NODATA, np.int16)
        lookup[[*NONBURNABLE, *CUSTOM]] = *NONBURNABLE, *CUSTOM
        table = self.crosswalk if to is FuelSystem.FBFM13 else self.crosswalk_back
        lookup[list(table)] = list(table.values())
        found = lookup[_index(codes)]
        if to is FuelSystem.FBFM13 and cover is not None:
            for code, (least, partner) in self.under_trees.items():
                found[(codes == code) & (cover >= least)] = partner
        return found

    def changed_codes(self, codes: Int16Array, system: FuelSystem, to: FuelSystem) -> Int16Array:
        """Return (...) codes of changed cells in the other system: those of `changed` for the same cover; NODATA for
        codes that `changed` does not list."""
        own, other = self.changed[system].model_dump(), self.changed[to].model_dump()
        found = np.full(codes.shape, NODATA, np.int16)
        # Covers that share a code in one system do not in the other: what is named first is the commoner.
        for key in reversed(own):
            found[codes == own[key]] = other[key]
        return found


def code_color(code: int) -> Color:
    """Return the colour of a fuel code of either system; grey where it is none."""
    return (222, 222, 220) if (known := fuel_models().find(code)) is None else known.color


def code_colors(codes: Int16Array) -> UInt8Array:
    """Return (..., 3) colours of codes (...)."""
    return np.array([code_color(code) for code in range(256)], np.uint8)[_index(codes)]


def code_names(codes: Int16Array) -> list[tuple[str, Color]]:
    """Return the name and colour of each code that occurs, the commonest first."""
    found, counts = np.unique(codes[codes != NODATA], return_counts=True)
    return [(fuel_models().name(int(code)), code_color(int(code))) for code in found[np.argsort(-counts)]]
