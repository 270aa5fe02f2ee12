"""Write the files beside an export: QGIS styles and STAC items."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final
from xml.etree.ElementTree import Element, ParseError, SubElement, fromstring, indent, tostring

import numpy as np

from ltm_core.base.types import Int16Array
from ltm_core.fuel.codes import Color, code_color, fuel_models
from ltm_core.fuel.export.provenance import Provenance, as_rows
from ltm_core.fuel.life_form import NODATA
from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.disk_io import written_whole

_MARK: Final = b"<!-- by ltm export -->"
"""Marker of style files that may be overwritten."""
Entry = tuple[int, str, Color]
"""Value, label and colour."""


def style_path(raster: Path) -> Path:
    """Return the path at which QGIS looks for the style of a raster."""
    return raster.with_suffix(".qml")


def style_owner(raster: Path) -> str | None:
    """Return the name of the export whose style is at the `style_path` of another of the same stem, as a.lcp and a.tif;
    None: this raster's own."""
    try:
        named = fromstring(style_path(raster).read_bytes()).get("raster", raster.name)
    except (OSError, ParseError):
        return None
    return named if named != raster.name and raster.with_name(named).exists() else None


def code_entries(codes: Int16Array) -> list[Entry]:
    """Return the fuel models that occur, by code."""
    names = fuel_models()
    found = np.unique(codes[codes != NODATA]).tolist()
    return [(code, f"{code} {names.name(code)}", code_color(code)) for code in found]


def write_palette_style(raster: Path, entries: Iterable[Entry], band: int = 1) -> Path:
    """Write a style that shows a band's values by name. Raises ConfigError if it cannot be written."""
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
    return _write(raster, renderer)


def write_grey_style(raster: Path, least: float, most: float) -> Path:
    """Write a style that shows the first band from black to white. Raises ConfigError if it cannot be written."""
    renderer = _renderer("singlebandgray", grayBand="1", gradient="BlackToWhite")
    stretch = SubElement(renderer, "contrastEnhancement")
    for name, text in (("minValue", f"{least:g}"), ("maxValue", f"{most:g}"), ("algorithm", "StretchToMinimumMaximum")):
        SubElement(stretch, name).text = text
    return _write(raster, renderer)


def _renderer(kind: str, **attributes: str) -> Element:
    return Element("rasterrenderer", {"type": kind, "opacity": "1", "alphaBand": "-1", **attributes})


def _write(raster: Path, renderer: Element) -> Path:
    path = style_path(raster)
    own = path.is_file() and _MARK not in path.read_bytes()[:500]
    if own or style_owner(raster) is not None:
        return path
    root = Element("qgis", version="3.22", styleCategories="Symbology", raster=raster.name)
    SubElement(root, "pipe").append(renderer)
    indent(root)
    with written_whole(path) as partial:
        partial.write_bytes(b"<!DOCTYPE qgis>\n" + _MARK + b"\n" + tostring(root, encoding="utf-8") + b"\n")
    return path


_TYPES: Final[Mapping[str, str]] = {
    ".tif": "image/tiff; application=geotiff",
    ".tiff": "image/tiff; application=geotiff",
    ".kmz": "application/vnd.google-earth.kmz",
    ".qml": "application/xml",
    ".prj": "text/plain",
}
_NEVER: Final = "1970-01-01T00:00:00Z"


def item_path(export: Path) -> Path:
    """Return the path of the STAC item of an export: beside a file, inside a folder."""
    return export / "item.stac.json" if export.is_dir() else export.with_name(f"{export.name}.stac.json")


def remove_item(export: Path) -> None:
    """Remove the item of an earlier export of the same name, which would describe the new one wrongly."""
    if export.is_file():
        item_path(export).unlink(missing_ok=True)


def stac_item(files: Iterable[Path], geometry: GridGeometry, made: Provenance) -> dict[str, Any]:
    """Return the item, with files as assets relative to it. Its own fields have the names of the GeoTIFF tags, with
    `ltm:`."""
    from rasterio.warp import transform_bounds

    west, south, east, north = (
        round(v, 7) for v in transform_bounds(geometry.crs, "EPSG:4326", *geometry.bounds, densify_pts=21)
    )
    ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
    moment = made.moment()
    # STAC wants a time or a range: of a map that no frame has touched, the range is all time until it is dated.
    times: dict[str, Any] = {"datetime": None, "start_datetime": _NEVER, "end_datetime": _NEVER}
    if moment is not None:
        times = {"datetime": moment.strftime("%Y-%m-%dT%H:%M:%SZ")}
    transform = geometry.transform()
    properties = {
        **times,
        "title": f"Fuel map of {made.site}",
        "description": made.line(),
        "gsd": geometry.resolution,
        "proj:code": geometry.crs,
        "proj:shape": list(geometry.shape),
        "proj:transform": list(transform)[:6],
        **{f"ltm:{name}": text for name, text in as_rows(made.tags())},
    }
    return {
        "type": "Feature",
        "stac_version": "1.0.0",
        "stac_extensions": [],
        "id": f"{made.site}-{made.as_of}".replace(":", "").replace(" ", "-"),
        "geometry": {"type": "Polygon", "coordinates": [ring]},
        "bbox": [west, south, east, north],
        "properties": properties,
        "links": [],
        "assets": {
            path.name: {
                "href": f"./{path.name}",
                "type": _TYPES.get(path.suffix.lower(), "application/octet-stream"),
                "roles": ["metadata"] if path.suffix in (".qml", ".prj") else ["data"],
            }
            for path in files
        },
    }


def write_item(export: Path, files: Iterable[Path], geometry: GridGeometry, made: Provenance) -> Path:
    """Write the item of an export. Raises ConfigError if it cannot be written."""
    path = item_path(export)
    with written_whole(path) as partial:
        partial.write_text(json.dumps(stac_item(files, geometry, made), indent=1) + "\n", encoding="utf-8")
    return path
