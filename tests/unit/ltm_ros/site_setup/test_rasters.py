"""Resampled heights: planes of the source's grid, which bilinear interpolation keeps exactly."""

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from pyproj import Transformer
from rasterio.transform import Affine, from_origin
from scenes.site_services import geotiff

from ltm_core.base.errors import RasterError
from ltm_core.geometry.grid import GridGeometry
from ltm_ros.site_setup.rasters import files_of, grid_over, overlapping, resample, site_resolution, tiles_of

US_FOOT = 1200 / 3937


@dataclass(frozen=True)
class Source:
    """A source's CRS, cell size, and the site that it covers."""

    crs: str
    size: float
    lon: float
    lat: float
    site: str


DEGREES = Source("EPSG:4326", 1 / 3600, -118.06, 34.22, "EPSG:32611")
SOURCES = {
    "degrees": DEGREES,
    "NAD83 degrees, a third of a second": Source("EPSG:4269", 1 / 10800, -118.06, 34.22, "EPSG:32611"),
    "US feet": Source("EPSG:2229", 32.0, -118.06, 34.22, "EPSG:32611"),
    "Albers": Source("EPSG:5070", 30.0, -118.06, 34.22, "EPSG:32611"),
    "the other zone": Source("EPSG:32610", 10.0, -120.001, 38.5, "EPSG:32611"),
    "southern hemisphere": Source("EPSG:4326", 1 / 3600, 149.1, -35.3, "EPSG:32755"),
    "Alaska": Source("EPSG:3338", 5.0, -149.5, 61.2, "EPSG:32606"),
    "Hawaii": Source("EPSG:4326", 1 / 3600, -155.6, 19.6, "EPSG:32605"),
    "Norway": Source("EPSG:25833", 10.0, 13.8, 66.65, "EPSG:32633"),
}


def grid_of(source: Source, side: float = 1500.0, size: float = 20.0) -> GridGeometry:
    x, y = Transformer.from_crs("EPSG:4326", source.site, always_xy=True).transform(source.lon, source.lat)
    return GridGeometry(x - side / 2, y + side / 3, size, round(side / size), round(side / 1.5 / size), source.site)


def middle(source: Source) -> tuple[float, float]:
    x, y = Transformer.from_crs("EPSG:4326", source.crs, always_xy=True).transform(source.lon, source.lat)
    return round(x / source.size) * source.size, round(y / source.size) * source.size


def plane(source: Source, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    x0, y0 = middle(source)
    return 700.0 + 1.3 * (x - x0) / source.size - 0.7 * (y - y0) / source.size


def write(
    path: Path,
    source: Source,
    cells: int,
    offset: tuple[int, int] = (0, 0),
    nodata: float = -9999.0,
    scale: float = 1.0,
    hole: bool = False,
    south_up: bool = False,
    crs: str | None = None,
    **tags: str,
) -> Path:
    """Write a plane about the middle of the source, moved by `offset` columns and rows."""
    x0, y0 = middle(source)
    west, north = x0 + (offset[0] - cells / 2) * source.size, y0 - (offset[1] - cells / 2) * source.size
    x = west + (np.arange(cells) + 0.5) * source.size
    y = north - (np.arange(cells) + 0.5) * source.size
    z = plane(source, *np.meshgrid(x, y)) / scale
    if hole:
        z[:, : cells // 2] = nodata
    transform = from_origin(west, north, source.size, source.size)
    if south_up:
        z = z[::-1]
        transform = Affine(source.size, 0, west, 0, source.size, north - cells * source.size)
    options = {"driver": "GTiff", "width": cells, "height": cells, "count": 1, "dtype": "float32"}
    with rasterio.open(path, "w", crs=crs or source.crs, transform=transform, nodata=nodata, **options) as sink:
        sink.write(z.astype(np.float32), 1)
        if tags.get("unit"):
            sink.set_band_unit(1, tags["unit"])
        if tags.get("registration"):
            sink.update_tags(AREA_OR_POINT=tags["registration"])
    return path


def expected(source: Source, grid: GridGeometry) -> np.ndarray:
    row, col = np.mgrid[0 : grid.height, 0 : grid.width]
    x, y = grid.to_map(row, col)
    return plane(source, *Transformer.from_crs(grid.crs, source.crs, always_xy=True).transform(x, y))


def resampled(paths: list[Path], grid: GridGeometry) -> np.ndarray:
    return resample(overlapping(tiles_of(paths), grid.bounds, grid.crs or ""), grid, None)[0]


@pytest.mark.parametrize("name", SOURCES)
def test_a_plane_stays_exact_in_any_crs(name: str, tmp_path: Path) -> None:
    source = SOURCES[name]
    grid = grid_of(source)
    found = resampled([write(tmp_path / "a.tif", source, 620)], grid)
    np.testing.assert_allclose(found, expected(source, grid), atol=2e-3)


@pytest.mark.parametrize(
    ("scale", "tags"),
    [
        (1.0, {"registration": "Point"}),
        (1.0, {"registration": "Area"}),
        (US_FOOT, {"unit": "US survey foot"}),
        (0.3048, {"unit": "ft"}),
        (US_FOOT, {"crs": "EPSG:4326+6360"}),
        (1.0, {"south_up": True}),
    ],
)
def test_registration_and_unit_of_the_file_are_kept(scale: float, tags: dict[str, Any], tmp_path: Path) -> None:
    grid = grid_of(DEGREES)
    found = resampled([write(tmp_path / "a.tif", DEGREES, 200, scale=scale, **tags)], grid)
    np.testing.assert_allclose(found, expected(DEGREES, grid), atol=2e-3)


@pytest.mark.parametrize("overlap", [0, 7])
def test_tiles_have_no_seam(overlap: int, tmp_path: Path) -> None:
    """Four tiles meet in the middle of the site, each with its own nodata value."""
    for k, (i, j) in enumerate(itertools.product((-1, 1), (-1, 1))):
        offset = i * (50 - overlap), j * (50 - overlap)
        write(tmp_path / f"{k}.tif", DEGREES, 100, offset, nodata=(-9999.0, -32768.0, 0.0, np.nan)[k])
    grid = grid_of(DEGREES)
    found = resampled([tmp_path], grid)
    np.testing.assert_allclose(found, expected(DEGREES, grid), atol=2e-3)


def test_tiles_of_two_grids_are_whole_where_they_overlap(tmp_path: Path) -> None:
    other = Source("EPSG:32610", 30.0, DEGREES.lon, DEGREES.lat, DEGREES.site)
    first = write(tmp_path / "a.tif", DEGREES, 200, hole=True)
    grid = grid_of(DEGREES)
    row, col = np.mgrid[0:200, 0:200]
    x0, y0 = middle(other)
    x, y = x0 + (col - 99.5) * 30.0, y0 - (row - 99.5) * 30.0
    lon, lat = Transformer.from_crs(other.crs, "EPSG:4326", always_xy=True).transform(x, y)
    heights = plane(DEGREES, lon, lat).astype(np.float32)
    (tmp_path / "b.tif").write_bytes(geotiff(heights, other.crs, x0 - 3000, y0 + 3000, 30))
    found = resampled([first, tmp_path / "b.tif"], grid)
    np.testing.assert_allclose(found, expected(DEGREES, grid), atol=0.02)  # the plane bends between the zones


@pytest.mark.parametrize("cell", [15.0, 4.0, 3.9])
def test_finer_cells_are_averaged(cell: float, tmp_path: Path) -> None:
    source = Source("EPSG:32611", 2.0, DEGREES.lon, DEGREES.lat, DEGREES.site)
    grid = grid_of(source, 600.0, cell)
    tile = write(tmp_path / "a.tif", source, 400)
    with rasterio.open(tile, "r+") as file:
        rough = file.read(1)
        rough[::2] += 8
        rough[1::2] -= 8  # rows that a sampled surface would take for ground
        file.write(rough, 1)
    np.testing.assert_allclose(resampled([tile], grid), expected(source, grid), atol=2.5)


def test_cells_of_a_file_in_the_crs_of_the_site_are_kept(tmp_path: Path) -> None:
    source = Source("EPSG:32611", 10.0, DEGREES.lon, DEGREES.lat, DEGREES.site)
    tiles = tiles_of([write(tmp_path / "a.tif", source, 100)])
    bounds = grid_of(source, 500.0).bounds
    grid = grid_over(bounds, site_resolution(tiles, 500.0, 8192), tiles, "EPSG:32611")
    row, col = tiles[0].north - grid.y_max, grid.x_min - tiles[0].west
    assert (row % 10, col % 10) == (0, 0)
    with rasterio.open(tmp_path / "a.tif") as file:
        stored = file.read(1)[round(row / 10) :, round(col / 10) :][: grid.height, : grid.width]
    np.testing.assert_array_equal(resampled([tmp_path / "a.tif"], grid), stored)


def test_a_file_that_covers_only_part_leaves_the_rest_unknown(tmp_path: Path) -> None:
    grid = grid_of(DEGREES)
    made, _ = resample(tiles_of([write(tmp_path / "a.tif", DEGREES, 200, hole=True)]), grid, None)
    known = np.isfinite(made)
    assert 0.4 < known.mean() < 0.6
    assert not known[:, 0].any()
    whole = known & np.roll(known, 2, axis=1)  # the cells at the hole's edge are nearer to it than to the next height
    np.testing.assert_allclose(made[whole], expected(DEGREES, grid)[whole], atol=2e-3)


@pytest.mark.parametrize(("size", "lat", "metres"), [(1 / 10800, 34.2, 10), (1 / 3600, 34.2, 30), (1 / 3600, -35, 30)])
def test_cell_size_of_degrees(size: float, lat: float, metres: float, tmp_path: Path) -> None:
    source = Source("EPSG:4326", size, 149.0, lat, "EPSG:32755")
    assert site_resolution(tiles_of([write(tmp_path / "a.tif", source, 50)]), 16_000, 8192) == metres


def test_cell_size_grows_with_the_site(tmp_path: Path) -> None:
    tiles = tiles_of([write(tmp_path / "a.tif", Source("EPSG:32611", 1.0, -118, 34, ""), 50)])
    assert [site_resolution(tiles, side, 8192) for side in (8_000, 16_000, 40_000)] == [1, 2, 5]


def test_files_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    grid = grid_of(DEGREES)
    elsewhere = write(tmp_path / "far.tif", SOURCES["Hawaii"], 50)
    with pytest.raises(RasterError, match="far"):
        overlapping(tiles_of([elsewhere]), grid.bounds, grid.crs or "")
    (tmp_path / "empty").mkdir()
    with pytest.raises(RasterError, match="empty"):
        files_of([tmp_path / "empty"])
    bare = tmp_path / "bare.tif"
    with rasterio.open(bare, "w", driver="GTiff", width=9, height=8, count=1, dtype="float32") as sink:
        sink.write(np.ones((8, 9), np.float32), 1)
    with pytest.raises(RasterError, match="bare"):
        tiles_of([bare])
