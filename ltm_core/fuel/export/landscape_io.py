"""Write landscapes of fire models: LCP, GeoTIFF, and the folder of rasters that ELMFIRE reads.

Layout of LCP files (FARSITE, FlamMap): a header of 7316 bytes, then int16 cells, row by row from the north, all bands
of a cell together; little-endian. The CRS is in a .prj file. Source: FlamMap's file format documentation, and GDAL's
reader as a check. GDAL's own writer swaps the east edges and writes class lists 32768 too high."""

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer

from ltm_core.base.errors import RasterError
from ltm_core.base.types import Int16Array
from ltm_core.fuel.codes import FuelSystem
from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.export.companion_files_io import code_entries, write_grey_style, write_palette_style
from ltm_core.fuel.export.landscape import LANDSCAPE_BANDS, LANDSCAPE_UNITS, Landscape
from ltm_core.fuel.life_form import NODATA
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import write_geotiff
from ltm_core.storage.disk_io import make_folder, written_whole
from ltm_core.vision.labels import LabelSet

_YES, _NO = 21, 20
_LISTED: Final = 99
"""Number of classes in a band's list of 100; its first entry is padding."""
_UNITS: Final = (0, 0, 2, 0, 1, 3, 3, 3, 0, 0)
"""Units of the bands: m; degrees; azimuth; codes; %; m x 10; m x 10; kg/m3 x 100; duff and woody fuel, which are
absent."""


def write_lcp(path: Path | str, landscape: Landscape, description: str = "") -> Path:
    """Write the eight bands, the CRS to a .prj of the same name, and a QGIS style. `description`: of which the header
    takes 511 characters of ASCII. The file appears whole or not at all. Raises ConfigError where it cannot be
    written."""
    path = Path(path)
    cells = np.ascontiguousarray(np.moveaxis(landscape.bands, 0, -1), "<i2")
    with written_whole(path) as partial:
        partial.write_bytes(lcp_header(landscape, description) + cells.tobytes())
        path.with_suffix(".prj").write_text(CRS(landscape.geometry.crs).to_wkt("WKT1_ESRI"), encoding="utf-8")
    write_palette_style(path, code_entries(landscape.band("fuel")), LANDSCAPE_BANDS.index("fuel") + 1)
    return path


def lcp_header(landscape: Landscape, description: str = "") -> bytes:
    """Return the header, 7316 bytes; see the module's source."""
    g = landscape.geometry
    to_degrees = Transformer.from_crs(g.crs, "EPSG:4326", always_xy=True)
    _, latitude = to_degrees.transform((g.x_min + g.x_max) / 2, (g.y_min + g.y_max) / 2)
    parts = [struct.pack("<3i4d", _YES, _NO, int(latitude), g.x_min, g.x_max, g.y_min, g.y_max)]
    parts += [_classes(band) for band in landscape.bands]
    parts += [_classes(np.zeros(0, np.int16))] * 2
    parts.append(struct.pack("<2i4d", g.width, g.height, g.x_max, g.x_min, g.y_max, g.y_min))
    parts.append(struct.pack("<i2d10h", 0, g.resolution, g.resolution, *_UNITS))
    names = [*(f"{name} of the fuel grid" for name in LANDSCAPE_BANDS), "", ""]
    parts += [struct.pack("<256s", name.encode("ascii", "replace")) for name in names]
    parts.append(struct.pack("<512s", description.encode("ascii", "replace")[:511]))
    return b"".join(parts)


def _classes(band: Int16Array) -> bytes:
    """Return the least and greatest value, how many there are, and their list: 412 bytes. Nodata is no value."""
    values = np.unique(band[band != NODATA]).astype(int).tolist()
    listed = [0, *values] if values and len(values) <= _LISTED else []
    count = len(values) if len(values) <= _LISTED else -1
    return struct.pack("<103i", *(values[:1] or [0]), *(values[-1:] or [0]), count, *listed, *[0] * (100 - len(listed)))


MOST_CELLS: Final = 60_000_000
MOST_NODATA: Final = 0.5
"""Maximum share of nodata cells; with a higher share, FlamMap and IFTDSS reject a GeoTIFF landscape."""
_ELMFIRE: Final[Mapping[str, str]] = {
    "dem": "elevation", "slp": "slope", "asp": "aspect",
    "cc": "cover", "ch": "height", "cbh": "base_height", "cbd": "bulk_density",
}  # fmt: skip
_LAYER_UNITS: Final[Mapping[str, str]] = {
    "prior": "code",
    "code": "code",
    "life_form": "class",
    "p_max": "1",
    "entropy": "1",
    "evidence": "1",
    "last_seen": "seconds since 1970-01-01 UTC, 0 never",
    "changed": "0 no, 1 yes",
    "seen_by": "cameras, 8 for more",
}


def write_landscape(path: Path | str, landscape: Landscape, tags: Mapping[str, str] | None = None) -> Path:
    """Write the eight bands as one GeoTIFF, as FlamMap 6.2 and IFTDSS take it, and a QGIS style beside it. Raises
    RasterError for a landscape that they would reject, ConfigError where it cannot be written."""
    path = Path(path)
    cells = landscape.geometry.width * landscape.geometry.height
    if cells >= MOST_CELLS:
        raise RasterError(f"{path}: {cells} cells; FlamMap reads fewer than {MOST_CELLS}: export a smaller area")
    unknown = float((landscape.bands == NODATA).any(axis=0).mean())
    if unknown > MOST_NODATA:
        shares = {name: float((landscape.band(name) == NODATA).mean()) for name in LANDSCAPE_BANDS}
        gaps = ", ".join(f"{name} is unknown in {share:.0%}" for name, share in shares.items() if share > 0)
        dem = shares["elevation"] >= shares["fuel"]
        raise RasterError(
            f"{path}: {unknown:.0%} of the cells have no data, FlamMap allows at most {MOST_NODATA:.0%}: {gaps}; give "
            f"the site {'a DEM that covers it' if dem else 'a prior fuel map without these gaps'}, a smaller DEM, or "
            "export ELMFIRE layers (--format elmfire)"
        )
    write_raster(path, landscape.bands, landscape.geometry, NODATA, LANDSCAPE_BANDS, LANDSCAPE_UNITS, tags=tags)
    write_palette_style(path, code_entries(landscape.band("fuel")), LANDSCAPE_BANDS.index("fuel") + 1)
    return path


def write_elmfire(folder: Path | str, landscape: Landscape, tags: Mapping[str, str] | None = None) -> Path:
    """Write the rasters that ELMFIRE's inputs name: adjustment factors of 1 and nothing burning besides. Raises
    ConfigError where the folder cannot be made."""
    folder = Path(folder)
    make_folder(folder)
    fuel = "fbfm40" if landscape.system is FuelSystem.FBFM40 else "fbfm13"
    for name, band in {**_ELMFIRE, fuel: "fuel"}.items():
        unit = LANDSCAPE_UNITS[LANDSCAPE_BANDS.index(band)]
        raster = folder / f"{name}.tif"
        write_raster(raster, landscape.band(band), landscape.geometry, NODATA, (band,), (unit,), tags=tags)
    write_palette_style(folder / f"{fuel}.tif", code_entries(landscape.band("fuel")))
    ones = np.ones(landscape.geometry.shape, np.float32)
    for name in ("adj", "phi"):
        write_raster(folder / f"{name}.tif", ones, landscape.geometry, NODATA, (name,), ("1",), tags=tags)
    return folder


def write_raster(
    path: Path,
    array: NDArray[Any],
    geometry: GridGeometry,
    nodata: float | None,
    names: tuple[str, ...] = (),
    units: tuple[str, ...] = (),
    tags: Mapping[str, str] | None = None,
) -> None:
    """Write a GeoTIFF atomically, with named bands. Raises ConfigError if it cannot be written."""
    import rasterio

    with written_whole(path) as partial:
        write_geotiff(partial, array, geometry, nodata, tags=tags)
        if names:
            with rasterio.open(partial, "r+") as sink:
                sink.descriptions, sink.units = names, units


def write_layers(
    folder: Path, layers: FuelLayers, geometry: GridGeometry, tags: Mapping[str, str], palette: LabelSet
) -> None:
    """Write every layer as a Cloud Optimized GeoTIFF with its name, unit and QGIS style; `palette`: of life forms.
    Raises ConfigError where it cannot be written."""
    make_folder(folder)
    nodata = {"prior": NODATA, "code": NODATA, "life_form": 255, "p_max": float("nan"), "entropy": float("nan")}
    for name, layer in {**vars(layers), "changed": layers.changed}.items():
        # GeoTIFF has no booleans, and seconds are fine enough for when a cell was seen.
        stored = layer.astype("uint8") if layer.dtype == bool else layer
        stored = (layer // 10**9).astype("uint32") if name == "last_seen" else stored
        raster = folder / f"{name}.tif"
        write_cog(raster, stored, geometry, nodata.get(name), {**tags, "unit": _LAYER_UNITS[name]}, name)
        if name in ("prior", "code"):
            write_palette_style(raster, code_entries(layer))
        elif name == "life_form":
            write_palette_style(raster, zip(range(len(palette.names)), palette.names, palette.colors, strict=True))
        else:
            known = stored[np.isfinite(stored)]
            write_grey_style(raster, 0.0, max(1.0, float(known.max())) if known.size else 1.0)


def write_cog(
    path: Path, array: NDArray[Any], geometry: GridGeometry, nodata: float | None, tags: Mapping[str, str], name: str
) -> None:
    """Write a Cloud Optimized GeoTIFF of one band, (H, W), with overviews by nearest cell. Raises ConfigError where it
    cannot be written."""
    from rasterio.io import MemoryFile
    from rasterio.shutil import copy

    profile = {"driver": "GTiff", "width": geometry.width, "height": geometry.height, "count": 1, "dtype": array.dtype}
    profile |= {"crs": geometry.crs, "transform": geometry.transform(), "nodata": nodata}
    with written_whole(path) as partial, MemoryFile() as memory:
        with memory.open(**profile) as sink:
            sink.write(array, 1)
            sink.update_tags(**tags)
            sink.set_band_description(1, name)
        with memory.open() as source:
            copy(source, partial, driver="COG", compress="deflate", resampling="nearest")
