"""Writes LCP files, the landscape format of FARSITE and FlamMap.

Layout: a header of 7316 bytes, then int16 cells, row by row from the north, all bands of a cell together; all
little-endian. The CRS stands beside it in a .prj file. Source: FlamMap's file format documentation, and GDAL's reader
as a check. GDAL's own writer is not used: it swaps the east edges and writes class lists 32768 too high.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Final

import numpy as np
from pyproj import CRS, Transformer

from ltm_core.errors import ConfigError
from ltm_core.fuel.export.landscape import LANDSCAPE_BANDS, Landscape
from ltm_core.fuel.export.qgis_style_io import code_entries, write_palette_style
from ltm_core.fuel.life_form import NODATA
from ltm_core.types import Int16Array

HEADER_BYTES: Final = 7316
_WITH_CROWN: Final = 21
_WITHOUT_GROUND: Final = 20
_LISTED: Final = 99
"""Classes of a band that its list of 100 takes: its first entry is padding."""
_UNITS: Final = (0, 0, 2, 0, 1, 3, 3, 3, 0, 0)
"""m; degrees; azimuth; codes as they are; %; m x 10; m x 10; kg/m3 x 100; duff and woody fuel, which are not there."""
_METRES: Final = 0


def write_lcp(path: Path | str, landscape: Landscape, description: str = "") -> Path:
    """Write the eight bands, the CRS to a .prj of the same name, and a QGIS style. `description`: of which the header
    takes 511 characters of ASCII. The file appears whole or not at all.

    Raises ConfigError where it cannot be written.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name}.partial")
    cells = np.ascontiguousarray(np.moveaxis(landscape.bands, 0, -1), "<i2")
    try:
        with partial.open("wb") as sink:
            sink.write(lcp_header(landscape, description))
            sink.write(cells.tobytes())
        path.with_suffix(".prj").write_text(CRS(landscape.geometry.crs).to_wkt("WKT1_ESRI"), encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise ConfigError(f"{path}: the landscape cannot be written there ({error.strerror})") from error
    write_palette_style(path, code_entries(landscape.band("fuel")), LANDSCAPE_BANDS.index("fuel") + 1)
    return path


def lcp_header(landscape: Landscape, description: str = "") -> bytes:
    """The header, 7316 bytes; see the module's source."""
    g = landscape.geometry
    to_degrees = Transformer.from_crs(g.crs, "EPSG:4326", always_xy=True)
    _, latitude = to_degrees.transform((g.x_min + g.x_max) / 2, (g.y_min + g.y_max) / 2)
    parts = [struct.pack("<3i4d", _WITH_CROWN, _WITHOUT_GROUND, int(latitude), g.x_min, g.x_max, g.y_min, g.y_max)]
    parts += [_classes(band) for band in landscape.bands]
    parts += [_classes(np.zeros(0, np.int16))] * 2
    parts.append(struct.pack("<2i4d", g.width, g.height, g.x_max, g.x_min, g.y_max, g.y_min))
    parts.append(struct.pack("<i2d10h", _METRES, g.resolution, g.resolution, *_UNITS))
    names = [*(f"{name} of the fuel grid" for name in LANDSCAPE_BANDS), "", ""]
    parts += [struct.pack("<256s", name.encode("ascii", "replace")) for name in names]
    parts.append(struct.pack("<512s", description.encode("ascii", "replace")[:511]))
    return b"".join(parts)


def _classes(band: Int16Array) -> bytes:
    """Least and greatest value, how many there are, and their list: 412 bytes. Nodata is no value."""
    values = np.unique(band[band != NODATA]).astype(int).tolist()
    if not values:
        return struct.pack("<103i", *[0] * 103)
    if len(values) > _LISTED:
        return struct.pack("<103i", values[0], values[-1], -1, *[0] * 100)
    listed = [0, *values, *[0] * (_LISTED - len(values))]
    return struct.pack("<103i", values[0], values[-1], len(values), *listed)
