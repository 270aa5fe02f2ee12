"""Write fuel maps as KMZ for globes."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from ltm_core.base.types import UInt8Array
from ltm_core.fuel.export.provenance import Provenance, as_rows
from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.disk_io import written_whole


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

    Raises ConfigError where it cannot be written."""
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
