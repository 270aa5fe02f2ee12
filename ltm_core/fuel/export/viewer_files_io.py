"""Write fuel maps for viewers: KMZ for globes, PLY and LAS point clouds."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import Float64Array, Int16Array, UInt8Array
from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.export.provenance import Provenance, as_rows
from ltm_core.fuel.life_form import LifeForm, life_form_labels
from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.disk_io import written_whole
from ltm_core.vision.labels import LabelSet


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
    time.

    Raises ConfigError where it cannot be written.
    """
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
    reproject(
        bands,
        warped,
        src_transform=source.transform(),
        src_crs=source.crs,
        dst_transform=transform,
        dst_crs="EPSG:4326",
        resampling=Resampling.nearest,
    )
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


_LAS_CLASS: Final = {
    LifeForm.GRASS: 3,
    LifeForm.SHRUB: 4,
    LifeForm.TREE: 5,
    LifeForm.BARE: 2,
    LifeForm.WATER: 9,
    LifeForm.BUILT: 6,
    LifeForm.BURNED: 2,
}
"""ASPRS classes: low, medium and high vegetation, ground, water, building."""


@dataclass(frozen=True, eq=False)
class FuelPoints:
    """Points of the fuel map. `xyz`: (N, 3) float64 in `crs`, metres. `life_form`: (N,) uint8. `code`: (N,) int16.
    `rgb`: (N, 3) uint8."""

    xyz: Float64Array
    life_form: UInt8Array
    code: Int16Array
    rgb: UInt8Array
    crs: str


def fuel_points(layers: FuelLayers, heights: Float64Array, geometry: GridGeometry, labels: LabelSet) -> FuelPoints:
    """Return the cells with known life form and height (H, W), at their centres. Raises ConfigError if there are
    none."""
    known = np.isfinite(heights) & (layers.life_form <= len(LifeForm)) & (layers.life_form > 0)
    if not known.any() or geometry.crs is None:
        raise ConfigError("no cell of the fuel map has a life form and a known height: there are no points to write")
    rows, cols = np.nonzero(known)
    x, y = geometry.to_map(rows, cols)
    forms = layers.life_form[known]
    palette = np.array(life_form_labels(labels).colors, np.uint8)
    return FuelPoints(
        np.column_stack([x, y, heights[known]]),
        forms,
        layers.code[known].astype(np.int16),
        palette[forms],
        geometry.crs,
    )


def write_ply(path: Path, points: FuelPoints, made: Provenance | None = None) -> None:
    """Write a binary PLY: x, y, z double, red, green, blue, life_form uchar, fuel_code short; CRS and provenance as
    comments."""
    table = np.empty(
        len(points.xyz),
        [("xyz", "<f8", 3), ("rgb", "u1", 3), ("life_form", "u1"), ("code", "<i2")],
    )
    table["xyz"], table["rgb"] = points.xyz, points.rgb
    table["life_form"], table["code"] = points.life_form, points.code
    names = ["double x", "double y", "double z", "uchar red", "uchar green", "uchar blue", "uchar life_form"]
    header = ["ply", "format binary_little_endian 1.0", f"comment crs {points.crs.splitlines()[0]}"]
    header += [] if made is None else [f"comment {name} {value}" for name, value in as_rows(made.tags())]
    header += [f"element vertex {len(table)}", *(f"property {name}" for name in names), "property short fuel_code"]
    with written_whole(path) as partial:
        partial.write_bytes(("\n".join([*header, "end_header"]) + "\n").encode("ascii", "replace") + table.tobytes())


def write_las(path: Path, points: FuelPoints, made: Provenance | None = None) -> None:
    """Write LAS 1.4 with ASPRS classes, colours, and the fuel code as an extra field. Needs laspy (the extra
    `export`)."""
    import laspy
    from pyproj import CRS

    header = laspy.LasHeader(version="1.4", point_format=7)
    header.offsets = np.floor(points.xyz.min(axis=0))
    header.scales = np.full(3, 0.001)
    header.add_crs(CRS(points.crs))
    if made is not None:
        header.generating_software = made.software[:32]
        told = made.line().encode("ascii", "replace")[:32_000]
        header.vlrs.append(laspy.VLR("LTM", 1, "description of the map"[:32], told))
    header.add_extra_dim(laspy.ExtraBytesParams("fuel_code", "int16", "surface fuel model"))
    cloud: Any = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = points.xyz.T
    classes = np.zeros(256, np.uint8)
    for form, number in _LAS_CLASS.items():
        classes[form] = number
    cloud.classification = classes[points.life_form]
    cloud.red, cloud.green, cloud.blue = (points.rgb.astype(np.uint16) * 257).T
    cloud.fuel_code = points.code
    with written_whole(path) as partial:
        cloud.write(str(partial))
