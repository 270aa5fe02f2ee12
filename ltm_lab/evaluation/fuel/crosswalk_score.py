"""Scores FBFM40 -> FBFM13 on fuel maps: whether a life form stays its own, and agreement with a map of both systems."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from ltm_core.base.types import BoolArray, Int16Array
from ltm_core.fuel.cell_counts import UNSEEN
from ltm_core.fuel.codes import Crosswalk, FuelClimate, FuelSystem, of_one_fuel_type
from ltm_core.fuel.decision import layers_of_classes
from ltm_core.fuel.export.landscape import surface_codes
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.prior import FuelPrior
from ltm_core.scoring.fuel_change import Share

UNBOUND: Final[Mapping[str, Mapping[int, int]]] = {
    "dry": {101: 1, 102: 5, 103: 3, 104: 3, 105: 3, 106: 3, 107: 3, 108: 3, 109: 3, 121: 5, 122: 5, 123: 5, 124: 5,
            141: 6, 142: 5, 143: 5, 144: 5, 145: 2, 146: 5, 147: 4, 148: 4, 149: 4, 161: 8, 162: 10, 163: 10, 164: 10,
            165: 10, 181: 8, 182: 8, 183: 8, 184: 8, 185: 8, 186: 9, 187: 10, 188: 9, 189: 9, 201: 11, 202: 12,
            203: 12, 204: 13},
    "humid": {101: 8, 102: 2, 103: 2, 104: 3, 105: 3, 106: 3, 107: 3, 108: 3, 109: 3, 121: 5, 122: 5, 123: 5, 124: 5,
              141: 5, 142: 5, 143: 7, 144: 5, 145: 4, 146: 5, 147: 4, 148: 4, 149: 7, 161: 8, 162: 9, 163: 10,
              164: 10, 165: 10, 181: 8, 182: 8, 183: 8, 184: 8, 185: 9, 186: 9, 187: 10, 188: 9, 189: 9, 201: 11,
              202: 12, 203: 12, 204: 13},
}  # fmt: skip
"""The climates' tables until they were bound to the fuel type: of each code the commonest partner in a real set,
whatever its life form. What `ltm-lab eval crosswalk` calls "unbound"."""
_GROUPS: Final[Mapping[str, tuple[range, range]]] = {
    "grass": (range(101, 110), range(1, 4)),
    "shrub": (range(141, 150), range(4, 8)),
    "timber": (range(161, 190), range(8, 11)),
}


@dataclass(frozen=True)
class CrosswalkScore:
    """Of one way from FBFM40 to FBFM13. `kept`: by fuel type, cells that stay in it. `agreement` with the map's own
    FBFM13, of cells with codes in both; `east`: of the eastern half, which the tables were not chosen on. None: the map
    has none.
    """

    way: str
    kept: Mapping[str, Share]
    agreement: Share | None
    east: Share | None


def score_crosswalk(prior: FuelPrior, climate_name: str) -> list[CrosswalkScore]:
    """The unbound table, the climate's, and both unchanged exports of a map that brings both systems.

    `prior`: loaded with its FBFM13 as given (`PriorConfig.own_fbfm13`).
    """
    climate = FuelClimate.named(climate_name)
    cover = None if prior.canopy is None else prior.canopy[0]
    ways = {
        "unbound table": Crosswalk.of(UNBOUND.get(climate_name, climate.crosswalk), {}).to_fbfm13(prior.codes),
        "table": climate.as_crosswalk().to_fbfm13(prior.codes, cover),
    }
    if prior.fbfm13 is not None:
        learned = climate.as_crosswalk().learned(prior.codes, prior.fbfm13, cover)
        ways["its own pairs"] = learned.to_fbfm13(prior.codes, cover)
        layers = layers_of_classes(np.full(prior.codes.shape, UNSEEN, np.uint8), prior, climate)
        within = np.where(of_one_fuel_type(prior.codes, prior.fbfm13), prior.fbfm13, NODATA).astype(np.int16)
        for way, own in (("within the fuel type", within), ("as given", prior.fbfm13)):
            exported = surface_codes(layers, replace(prior, fbfm13=own), climate, FuelSystem.FBFM13)
            ways[f"export, its own FBFM13 {way}"] = exported
    return [_score(way, codes, prior) for way, codes in ways.items()]


def _score(way: str, codes: Int16Array, prior: FuelPrior) -> CrosswalkScore:
    kept = {
        name: _share(np.isin(codes, list(group)), np.isin(prior.codes, list(own)))
        for name, (own, group) in _GROUPS.items()
    }
    if prior.fbfm13 is None:
        return CrosswalkScore(way, kept, None, None)
    both = (prior.codes != NODATA) & (prior.fbfm13 != NODATA)
    east = both & (np.arange(both.shape[1]) >= both.shape[1] // 2)
    same = codes == prior.fbfm13
    return CrosswalkScore(way, kept, _share(same, both), _share(same, east))


def _share(right: BoolArray, of: BoolArray) -> Share:
    return Share(int((right & of).sum()), int(of.sum()))
