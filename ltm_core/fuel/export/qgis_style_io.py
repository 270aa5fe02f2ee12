"""Writes QGIS layer styles (.qml) beside rasters, so that codes and classes appear with their names and colours."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from ltm_core.errors import ConfigError
from ltm_core.fuel.codes import fuel_models
from ltm_core.fuel.life_form import NODATA
from ltm_core.pictures.fuel_colors import Color, code_color
from ltm_core.types import Int16Array

_MARK: Final = b"<!-- by ltm export -->"
"""Of styles that may be written over."""
Entry = tuple[int, str, Color]
"""A value, its label and its colour."""


def style_path(raster: Path) -> Path:
    """Where QGIS looks for the style of a raster."""
    return raster.with_suffix(".qml")


def code_entries(codes: Int16Array) -> list[Entry]:
    """The fuel models that occur, by code."""
    names = fuel_models()
    found = np.unique(codes[codes != NODATA]).tolist()
    return [(code, f"{code} {names.name(code)}", code_color(code)) for code in found]


def write_palette_style(raster: Path, entries: Iterable[Entry], band: int = 1) -> Path:
    """A style that shows a band's values by name. Raises ConfigError where it cannot be written."""
    renderer = _renderer("paletted", band=str(band))
    palette = SubElement(renderer, "colorPalette")
    for value, label, color in entries:
        SubElement(
            palette,
            "paletteEntry",
            value=str(value),
            label=label,
            color="#{:02x}{:02x}{:02x}".format(*color),
            alpha="255",
        )
    return _write(style_path(raster), renderer)


def write_grey_style(raster: Path, least: float, most: float, band: int = 1) -> Path:
    """A style that shows a band from black to white. Raises ConfigError where it cannot be written."""
    renderer = _renderer("singlebandgray", grayBand=str(band), gradient="BlackToWhite")
    stretch = SubElement(renderer, "contrastEnhancement")
    for name, text in (
        ("minValue", f"{least:g}"),
        ("maxValue", f"{most:g}"),
        ("algorithm", "StretchToMinimumMaximum"),
    ):
        SubElement(stretch, name).text = text
    return _write(style_path(raster), renderer)


def _renderer(kind: str, **attributes: str) -> Element:
    return Element("rasterrenderer", {"type": kind, "opacity": "1", "alphaBand": "-1", **attributes})


def _write(path: Path, renderer: Element) -> Path:
    if path.is_file() and _MARK not in path.read_bytes()[:500]:
        return path  # somebody's own style
    root = Element("qgis", version="3.22", styleCategories="Symbology")
    SubElement(root, "pipe").append(renderer)
    indent(root)
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.write_bytes(b"<!DOCTYPE qgis>\n" + _MARK + b"\n" + tostring(root, encoding="utf-8") + b"\n")
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise ConfigError(f"{path}: cannot be written there ({error.strerror})") from error
    return path
