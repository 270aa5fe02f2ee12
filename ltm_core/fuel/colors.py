"""Colours and names of surface fuel models."""

from __future__ import annotations

from typing import Final

import numpy as np

from ltm_core.base.types import Int16Array, UInt8Array
from ltm_core.fuel.codes import fuel_models
from ltm_core.fuel.life_form import NODATA

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
