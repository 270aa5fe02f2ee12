"""Readers of rasters: elevation, fuel codes, fuel maps."""

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rasterio.shutil
from scenes.rasters import rough_terrain

from fuzz.target import Target
from ltm_core.fire.effect import read_landscape
from ltm_core.fuel.class_map import read_fuel_map, write_fuel_map
from ltm_core.fuel.fuel_bands_io import quantity_of
from ltm_core.fuel.life_form import life_form_labels
from ltm_core.fuel.overlays_io import BarrierConfig, barrier_codes
from ltm_core.fuel.prior import PriorConfig, load_prior
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem, read_around
from ltm_core.vision.labels import LabelSet

GRID = GridGeometry(480_000.0, 4_150_600.0, 30.0, 27, 20, "EPSG:26911")


def _dems(folder: Path) -> list[bytes]:
    heights, files = rough_terrain(7, (60, 81)).elevation, []
    Dem(heights, GridGeometry(480_000.0, 4_150_600.0, 10.0, 81, 60, "EPSG:26911")).save(folder / "made.tif")
    files.append((folder / "made.tif").read_bytes())
    with rasterio.open(folder / "made.tif") as source:
        profile = source.profile
    for options in (
        {"compress": "lzw", "tiled": False, "dtype": "int16", "nodata": -32768},
        {"compress": "none", "tiled": False, "predictor": 1, "dtype": "float64"},
    ):
        with rasterio.open(folder / "made.tif", "w", **(profile | options)) as sink:
            sink.write(heights.astype(options["dtype"]), 1)
            sink.scales, sink.offsets = (0.5,), (3.0,)
        files.append((folder / "made.tif").read_bytes())
    return files


def _ascii(folder: Path) -> list[bytes]:
    (folder / "dem.prj").write_text(str(rasterio.crs.CRS.from_epsg(26911).to_wkt()))
    rows = "\n".join(" ".join(f"{v:.1f}" for v in row) for row in rough_terrain(7, (12, 9)).elevation)
    head = "ncols 9\nnrows 12\nxllcorner 480000\nyllcorner 4150000\ncellsize 60\nNODATA_value -9999\n"
    return [(head + rows + "\n").encode()]


def _read_dem(name: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        try:
            Dem.open(folder / name)
        finally:
            bounds = (480_100.0, 4_150_100.0, 480_500.0, 4_150_400.0)
            read_around(folder / name, None, "EPSG:26911", bounds)
            read_around(folder / name, None, "EPSG:32612", (-50_500.0, 4_168_300.0, -50_200.0, 4_168_600.0))

    return read


_PLAUSIBLE = (700, 20, 90, 0, 50, 200, 40, 12)
"""Values of the bands of a landscape, other than of codes."""


def _codes(bands: int) -> bytes:
    codes = np.random.default_rng(4).choice([101, 122, 145, 165, 91, -9999], GRID.shape).astype(np.int16)
    with rasterio.io.MemoryFile() as memory:
        with memory.open(
            driver="GTiff", count=bands, dtype="int16", crs=GRID.crs, transform=GRID.transform(), nodata=-9999,
            width=GRID.width, height=GRID.height, compress="deflate",
        ) as sink:  # fmt: skip
            for band in range(1, bands + 1):
                sink.write(codes if band in (1, 4) else np.full_like(codes, _PLAUSIBLE[band - 1]), band)
        return bytes(memory.read())


def _lcp(folder: Path) -> list[bytes]:
    with rasterio.io.MemoryFile(_codes(8)) as memory, memory.open() as source:
        rasterio.shutil.copy(source, folder / "made.lcp", driver="LCP", LATITUDE=34, LINEAR_UNIT="METER")
    return [(folder / "made.lcp").read_bytes()]


def _lcp_with_crs(folder: Path) -> list[bytes]:
    (folder / "land.prj").write_text(str(rasterio.crs.CRS.from_epsg(26911).to_wkt()))
    return _lcp(folder)


def _read_prior(name: str) -> Callable[[Path], object]:
    return lambda folder: load_prior(PriorConfig(path=folder / name, crs="EPSG:26911"), GRID)


def _tables(folder: Path) -> list[bytes]:
    fields = b"".join(struct.pack("<11sc4xB15x", name, b"N", 10) for name in (b"VALUE", b"FBFM40"))
    return [struct.pack("<4BIHH20x", 3, 124, 4, 23, 0, 97, 21) + fields + b"\r"]


def _metadata(folder: Path) -> list[bytes]:
    table = b"<GDALRasterAttributeTable><FieldDefn><Name>FBFM40</Name></FieldDefn></GDALRasterAttributeTable>"
    return [b'<PAMDataset><PAMRasterBand band="1">' + table + b"</PAMRasterBand></PAMDataset>"]


def _fuel_map(folder: Path) -> list[bytes]:
    classes = np.random.default_rng(5).integers(0, 5, GRID.shape, np.uint8)
    return [write_fuel_map(folder / "made.tif", classes, GRID, life_form_labels(LabelSet.load())).read_bytes()]


def _barriers(folder: Path) -> list[bytes]:
    ring = [[-117.2, 37.5], [-117.1, 37.5], [-117.1, 37.6], [-117.2, 37.5]]
    shapes = ({"type": "Polygon", "coordinates": [ring]}, {"type": "LineString", "coordinates": ring[:2]})
    features = [{"type": "Feature", "properties": {}, "geometry": shape} for shape in shapes]
    return [json.dumps({"type": "FeatureCollection", "features": features}).encode()]


RASTER_FILES = (
    Target("dem_tif", "dem.tif", _dems, _read_dem("dem.tif")),
    Target("dem_asc", "dem.asc", _ascii, _read_dem("dem.asc")),
    Target("prior_tif", "prior.tif", lambda folder: [_codes(1), _codes(8)], _read_prior("prior.tif")),
    Target("prior_lcp", "prior.lcp", _lcp, _read_prior("prior.lcp")),
    Target("prior_folder", "bands/fbfm40.tif", lambda folder: [_codes(1)], _read_prior("bands")),
    Target(
        "barriers",
        "b.geojson",
        _barriers,
        lambda f: barrier_codes([BarrierConfig(path=f / "b.geojson", kind="road")], GRID),
    ),
    Target("landscape_tif", "land.tif", lambda folder: [_codes(8)], lambda f: read_landscape(f / "land.tif")),
    Target("landscape_lcp", "land.lcp", _lcp_with_crs, lambda f: read_landscape(f / "land.lcp")),
    Target("attribute_table", "x.tif.vat.dbf", _tables, lambda folder: quantity_of(folder / "x.tif")),
    Target("raster_metadata", "x.tif.aux.xml", _metadata, lambda folder: quantity_of(folder / "x.tif")),
    Target("fuel_map", "map.tif", _fuel_map, lambda folder: read_fuel_map(folder / "map.tif")),
)
