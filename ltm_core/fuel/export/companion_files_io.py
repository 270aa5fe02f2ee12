"""Write the files beside an export, QGIS styles and STAC items, and KMZ for globes."""

import io
import json
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final
from xml.etree.ElementTree import Element, ParseError, SubElement, fromstring, indent, tostring
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from ltm_core.base.types import Int16Array, UInt8Array
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
    palette = Element("colorPalette")
    for value, label, color in entries:
        shown = {"value": str(value), "label": label, "color": "#{:02x}{:02x}{:02x}".format(*color), "alpha": "255"}
        SubElement(palette, "paletteEntry", shown)
    return _write(raster, {"type": "paletted", "band": str(band)}, palette)


def write_grey_style(raster: Path, least: float, most: float) -> Path:
    """Write a style that shows the first band from black to white. Raises ConfigError if it cannot be written."""
    stretch = Element("contrastEnhancement")
    for name, text in (("minValue", f"{least:g}"), ("maxValue", f"{most:g}"), ("algorithm", "StretchToMinimumMaximum")):
        SubElement(stretch, name).text = text
    return _write(raster, {"type": "singlebandgray", "grayBand": "1", "gradient": "BlackToWhite"}, stretch)


def _write(raster: Path, renderer: Mapping[str, str], content: Element) -> Path:
    path = style_path(raster)
    own = path.is_file() and _MARK not in path.read_bytes()[:500]
    if own or style_owner(raster) is not None:
        return path
    root = Element("qgis", version="3.22", styleCategories="Symbology", raster=raster.name)
    pipe = SubElement(root, "pipe")
    SubElement(pipe, "rasterrenderer", {"opacity": "1", "alphaBand": "-1", **renderer}).append(content)
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


def write_item(export: Path, files: Iterable[Path], geometry: GridGeometry, made: Provenance) -> Path:
    """Write the item of an export, with files as assets relative to it. Its own fields have the names of the GeoTIFF
    tags, with `ltm:`. Raises ConfigError if it cannot be written."""
    from rasterio.warp import transform_bounds

    bounds = transform_bounds(geometry.crs, "EPSG:4326", *geometry.bounds, densify_pts=21)
    west, south, east, north = (round(v, 7) for v in bounds)
    ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
    moment = made.moment()
    # STAC wants a time or a range: of a map that no frame has touched, the range is all time until it is dated.
    times: dict[str, Any] = {"datetime": None, "start_datetime": _NEVER, "end_datetime": _NEVER}
    item = {
        "type": "Feature",
        "stac_version": "1.0.0",
        "stac_extensions": [],
        "id": f"{made.site}-{made.as_of}".replace(":", "").replace(" ", "-"),
        "geometry": {"type": "Polygon", "coordinates": [ring]},
        "bbox": [west, south, east, north],
        "properties": {
            **(times if moment is None else {"datetime": moment.strftime("%Y-%m-%dT%H:%M:%SZ")}),
            "title": f"Fuel map of {made.site}",
            "description": made.line(),
            "gsd": geometry.resolution,
            "proj:code": geometry.crs,
            "proj:shape": list(geometry.shape),
            "proj:transform": list(geometry.transform())[:6],
            **{f"ltm:{name}": text for name, text in as_rows(made.tags())},
        },
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
    with written_whole(item_path(export)) as partial:
        partial.write_text(json.dumps(item, indent=1) + "\n", encoding="utf-8")
    return item_path(export)


def write_kmz(
    path: Path,
    picture: UInt8Array,
    geometry: GridGeometry,
    name: str,
    legend: UInt8Array,
    made: Provenance | None = None,
    shows: str = "life forms",
) -> None:
    """Write a KMZ of an image `picture` (n H, n W, 3) of a grid (H, W), warped to longitude and latitude, transparent
    outside; `legend` (h, w, 3) is fixed in the screen's corner; `made`: the description shown by the viewer, and its
    time. Raises ConfigError where it cannot be written."""
    from PIL import Image
    from rasterio.transform import array_bounds
    from rasterio.warp import Resampling, calculate_default_transform, reproject

    scale = geometry.resolution * geometry.width / picture.shape[1]
    source = GridGeometry(geometry.x_min, geometry.y_max, scale, picture.shape[1], picture.shape[0], geometry.crs)
    transform, width, height = calculate_default_transform(
        source.crs, "EPSG:4326", source.width, source.height, *source.bounds
    )
    bands = np.concatenate([np.moveaxis(picture, -1, 0), np.full((1, *picture.shape[:2]), 255, np.uint8)])
    warped = np.zeros((4, height, width), np.uint8)
    onto = {"dst_transform": transform, "dst_crs": "EPSG:4326", "resampling": Resampling.nearest}
    reproject(bands, warped, src_transform=source.transform(), src_crs=source.crs, **onto)
    west, south, east, north = array_bounds(height, width, transform)
    images = {"map.png": np.moveaxis(warped, 0, -1), "legend.png": legend}
    document = (
        '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document>'
        f"<name>{escape(name)}</name>{_told(made)}<GroundOverlay><name>{escape(shows)}</name><Icon><href>map.png</href></Icon>"
        f"<LatLonBox><north>{north:.9f}</north><south>{south:.9f}</south><east>{east:.9f}</east>"
        f"<west>{west:.9f}</west></LatLonBox></GroundOverlay>"
        "<ScreenOverlay><name>legend</name><Icon><href>legend.png</href></Icon>"
        '<overlayXY x="0" y="0" xunits="fraction" yunits="fraction"/>'
        '<screenXY x="0.02" y="0.05" xunits="fraction" yunits="fraction"/></ScreenOverlay></Document></kml>\n'
    )
    with written_whole(path) as partial, zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("doc.kml", document)
        for file, pixels in images.items():
            image = io.BytesIO()
            Image.fromarray(pixels).save(image, "PNG")
            archive.writestr(file, image.getvalue())


def _told(made: Provenance | None) -> str:
    if made is None:
        return ""
    rows = "".join(
        f"<Data name={quoteattr(key)}><value>{escape(value)}</value></Data>" for key, value in as_rows(made.tags())
    )
    moment = made.moment()
    when = "" if moment is None else f"<TimeStamp><when>{moment.strftime('%Y-%m-%dT%H:%M:%SZ')}</when></TimeStamp>"
    # In the order that KML's schema has for a feature.
    return f"<description>{escape(made.line())}</description>{when}<ExtendedData>{rows}</ExtendedData>"
