"""Windows of remote GeoTIFFs: cells, seams, holes, bytes and interruptions, against services on loopback."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.io import MemoryFile
from rasterio.warp import transform
from scenes.site_services import SiteServices, area_around, geotiff, grid, opened, silent

from ltm_core.base.errors import LtmError
from ltm_ros.site_setup.request import Area, Kind, NoCoverageError
from ltm_ros.site_setup.source import Source
from ltm_ros.site_setup.sources import choose

STEP = 1 / 360
AREA = area_around(-118.0, 34.6, 8000.0)
"""Across the edge of two tiles."""


@pytest.fixture
def services() -> Iterator[SiteServices]:
    with SiteServices() as services:
        yield services


def named(services: SiteServices, folder: Path, name: str, **keys: object) -> Source:
    return next(s for s in services.loaded(folder, **{name: keys}) if s.name == name)


def plane(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    return 1000.0 + 100.0 * (lon + 118.0) + 10.0 * (lat - 34.0)


def add_degree_tile(services: SiteServices, name: str, west: int, north: int, overlap: int, shift: float) -> None:
    """Add a tile of a degree with `overlap` cells beyond each edge; `shift`: of the whole grid, in cells."""
    left, top, size = west - (overlap - shift) * STEP, north + (overlap - shift) * STEP, 360 + 2 * overlap
    heights = plane(*grid(left, top, STEP, size, size)).astype(np.float32)
    crs = "EPSG:4269" if name.startswith("USGS") else "EPSG:4326"
    services.files[f"/cog/{name}.tif"] = geotiff(heights, crs, left, top, STEP)


TILES = {
    "usgs_3dep_10m": (["USGS_13_n35w119", "USGS_13_n35w118"], 6, 0.0, "EPSG:5703"),
    "copernicus_glo30": (["GLO30_N34_00_W119", "GLO30_N34_00_W118"], 0, -0.5, "EPSG:3855"),
}


@pytest.mark.parametrize("name", TILES)
def test_windows_of_neighbouring_tiles_join_without_seam_and_shift(
    name: str, services: SiteServices, tmp_path: Path
) -> None:
    files, overlap, shift, vertical = TILES[name]
    for file, west in zip(files, (-119, -118), strict=True):
        add_degree_tile(services, file, west, 35, overlap, shift)
    source = named(services, tmp_path, name, resolution_m=277.0)
    plan = source.plan(AREA)
    fetched = source.fetch(plan, tmp_path / "out", silent)
    cells: dict[tuple[int, int], float] = {}
    for path in fetched.files:
        values, about = opened(path)
        rows, columns = np.indices(values.shape)
        x, y = about.transform * (columns + 0.5, rows + 0.5)
        np.testing.assert_allclose(values, plane(x, y), atol=1e-4)
        index = np.round(np.stack([x, y], axis=-1) / STEP - 0.5 + shift).astype(int).reshape(-1, 2)
        cells.update(zip(map(tuple, index), values.ravel(), strict=True))
    west, south, east, north = AREA.bounds_lonlat
    wanted = {
        (i, j)
        for i in range(round(west / STEP) - 2, round(east / STEP) + 2)
        for j in range(round(south / STEP) - 2, round(north / STEP) + 2)
    }
    assert wanted <= cells.keys()
    assert (fetched.vertical_crs, fetched.source, len(fetched.files)) == (vertical, name, 2)


def test_a_site_fetches_at_most_twice_the_bytes_that_it_uses(services: SiteServices, tmp_path: Path) -> None:
    """Elevation, coarse elevation to 40 km and fuels of Getty, 8 km; tiles and blocks (512 and 1024 cells) as those of
    the real files, with a quarter of the cells per side."""
    rng = np.random.default_rng(3)
    step = 4 / 10_800
    fine = rng.integers(0, 1 << 20, (2704, 2704)).astype(np.float32)
    services.files["/cog/USGS_13_n35w119.tif"] = geotiff(
        fine, "EPSG:4269", -119 - 2 * step, 35 + 2 * step, step, block=128
    )
    for south in (33, 34):
        noise = rng.integers(0, 1 << 20, (900, 900)).astype(np.float32)
        services.files[f"/cog/GLO30_N{south}_00_W119.tif"] = geotiff(
            noise, "EPSG:4326", -119 - 0.5 / 900, south + 1 + 0.5 / 900, 1 / 900, block=256
        )
    near, wide = (area_around(-118.47, 34.09, radius) for radius in (8000.0, 40_000.0))
    quarter = {"usgs_3dep_10m": {"resolution_m": 41.2}, "copernicus_glo30": {"resolution_m": 123.6}}
    listed = services.loaded(tmp_path, **quarter)
    used = expected = 0.0
    cases: list[tuple[Kind, Area]] = [("dem", near), ("coarser", wide), ("fuel", near)]
    for kind, area in cases:
        choice = choose(kind, area, listed)
        expected += choice.plan.expected_bytes
        for path in choice.fetch(tmp_path / kind, silent).files:
            _, about = opened(path)
            west, south, east, north = about.bounds
            lon, lat = transform(about.crs, "EPSG:4326", [west, east], [south, north])
            a = area.bounds_lonlat
            inside = max(0.0, min(lon[1], a[2]) - max(lon[0], a[0])) * max(0.0, min(lat[1], a[3]) - max(lat[0], a[1]))
            used += path.stat().st_size * inside / ((lon[1] - lon[0]) * (lat[1] - lat[0]))
    print(f"{services.bytes_sent / used:.2f} of the bytes used, {services.bytes_sent / expected:.2f} of those expected")
    assert used < services.bytes_sent <= 2 * used
    assert services.bytes_sent <= 1.1 * expected


def test_an_older_file_of_a_tile_is_fetched_only_where_the_newer_one_has_holes(
    services: SiteServices, tmp_path: Path
) -> None:
    ground = np.full((300, 320), 1.0, np.float32)
    partly = np.where(np.arange(320) < 150, 3.0, -9999.0).astype(np.float32) * np.ones((300, 1), np.float32)
    for tile, west in (("x40y384", 400_000.0), ("x41y384", 409_600.0)):
        place = ("EPSG:26911", west, 3_840_000.0, 30.0)
        newest = ground + 2 if tile == "x41y384" else partly
        services.add_product(f"USGS_1M_11_{tile}_New.tif", geotiff(newest, *place, nodata=-9999.0), "2023-05-01")
        services.add_product(f"USGS_1M_11_{tile}_Old.tif", geotiff(ground, *place, nodata=-9999.0), "2012-05-01")
    source = named(services, tmp_path, "usgs_3dep_1m", resolution_m=30.0)
    area = Area((-118.06, 34.64, -117.93, 34.66))
    fetched = source.fetch(source.plan(area), tmp_path / "out", silent)
    assert [path.name[11:] for path in fetched.files] == ["x40y384_New.tif", "x41y384_New.tif", "x40y384_Old.tif"]
    assert fetched.year == 2023


def test_a_source_that_covers_part_of_an_area_is_passed_over_with_its_share(
    services: SiteServices, tmp_path: Path
) -> None:
    west, _, east, north = AREA.bounds_lonlat
    half = geotiff(np.ones((200, 200), np.float32), "EPSG:4326", west - 0.01, north + 0.01, (east - west + 0.02) / 400)
    services.add_product("x1y1.tif", half, "2020")
    for file, left in zip(TILES["copernicus_glo30"][0], (-119, -118), strict=True):
        add_degree_tile(services, file, left, 35, 0, -0.5)
    choice = choose("dem", AREA, services.loaded(tmp_path))
    assert choice.source.name == "copernicus_glo30"
    assert [note.split()[0] for note in choice.plan.notes] == ["usgs_3dep_1m", "usgs_3dep_10m", "usgs_3dep_10m_hawaii"]


def test_items_of_a_catalogue_of_several_pages_are_fetched(services: SiteServices, tmp_path: Path) -> None:
    for number, west in enumerate((-119, -118)):
        heights = plane(*grid(west, 35.0, STEP, 360, 360)).astype(np.float32)
        services.add_stac_item(f"{number}/dem.tif", geotiff(heights, "EPSG:4326", west, 35.0, STEP))
    source = named(services, tmp_path, "earth_search_glo30", resolution_m=277.0)
    fetched = source.fetch(source.plan(AREA), tmp_path / "out", silent)
    assert {path.name for path in fetched.files} == {"dem.tif", "1_dem.tif"}
    assert all(url.startswith(services.url) for url in fetched.urls)


def test_after_an_interruption_only_the_missing_blocks_are_fetched(
    services: SiteServices, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ltm_ros.site_setup.windows._RANGE_BYTES", 1 << 16)
    noise = np.random.default_rng(1).integers(0, 1 << 20, (720, 720)).astype(np.float32)
    services.files["/cog/GLO30_N34_00_W119.tif"] = geotiff(noise, "EPSG:4326", -119, 35.0, 1 / 720)
    source = named(services, tmp_path, "copernicus_glo30", resolution_m=154.0)
    plan = source.plan(Area((-118.99, 34.01, -118.01, 34.99)))
    before = services.bytes_sent

    def interrupt(done: int, total: int) -> None:
        if done > total / 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        source.fetch(plan, tmp_path / "out", interrupt)
    assert not (tmp_path / "out").exists()
    interrupted = services.bytes_sent
    again = source.fetch(plan, tmp_path / "out", silent)
    np.testing.assert_array_equal(opened(again.files[0])[0], noise[4:-4, 4:-4])
    assert services.bytes_sent - interrupted < 0.8 * plan.expected_bytes
    assert services.bytes_sent - before < 1.4 * plan.expected_bytes
    assert not list((tmp_path / "cache").glob("*.part")) + list((tmp_path / "cache").glob("*.ranges"))


@pytest.mark.parametrize("layout", ["COG", "directories at the end", "BigTIFF", "big-endian", "strips"])
def test_files_of_all_layouts_are_read(layout: str, services: SiteServices, tmp_path: Path) -> None:
    """With overviews, leaders before the blocks, a unit; larger than what is read first."""
    noise = np.random.default_rng(5).integers(0, 1 << 20, (720, 720)).astype(np.float32)
    path = tmp_path / "layout.tif"
    options = {
        "COG": {"driver": "COG", "BLOCKSIZE": 128},
        "BigTIFF": {"BIGTIFF": "YES", "tiled": True, "blockxsize": 64, "blockysize": 64},
        "big-endian": {"ENDIANNESS": "BIG"},
    }
    with rasterio.open(
        path, "w", width=720, height=720, count=1, dtype="float32", crs="EPSG:4326", COMPRESS="DEFLATE",
        transform=rasterio.transform.from_origin(-119.0, 35.0, 1 / 720, 1 / 720), **options.get(layout, {}),
    ) as sink:  # fmt: skip
        sink.write(noise, 1)
        sink.set_band_unit(1, "metre")
    if layout == "directories at the end":
        with rasterio.open(path, "r+") as sink:
            sink.build_overviews([2, 4])
            sink.update_tags(AFTERWARDS="x" * 3000)
    services.files["/cog/GLO30_N34_00_W119.tif"] = path.read_bytes()
    source = named(services, tmp_path, "copernicus_glo30", resolution_m=154.0)
    fetched = source.fetch(source.plan(Area((-118.699, 34.301, -118.301, 34.699))), tmp_path / "out", silent)
    values, _ = opened(fetched.files[0])
    np.testing.assert_array_equal(values, noise[213:507, 213:507])
    with rasterio.open(fetched.files[0]) as raster:
        assert raster.units == ("metre",)


def test_a_damaged_file_is_a_clear_error_and_is_fetched_again_next_time(services: SiteServices, tmp_path: Path) -> None:
    add_degree_tile(services, "GLO30_N34_00_W119", -119, 35, 0, 0.0)
    name, whole = next(iter(services.files.items()))
    area = area_around(-118.5, 34.5, 8000.0)
    plan = named(services, tmp_path, "copernicus_glo30", resolution_m=277.0).plan(area)
    services.files[name] = whole[: len(whole) // 2] + bytes(len(whole) - len(whole) // 2)
    source = named(services, tmp_path, "copernicus_glo30", resolution_m=277.0)
    with pytest.raises(LtmError):
        source.fetch(plan, tmp_path / "out", silent)  # changed since it was planned
    with pytest.raises(LtmError):
        source.fetch(source.plan(area), tmp_path / "out", silent)
    services.files[name] = whole
    assert len(source.fetch(plan, tmp_path / "out", silent).files) == 1


def test_sea_has_no_tile_and_unknown_cells_are_no_coverage(services: SiteServices, tmp_path: Path) -> None:
    source = named(services, tmp_path, "copernicus_glo30", resolution_m=277.0)
    with pytest.raises(NoCoverageError, match="sea"):
        source.plan(area_around(-30.0, 20.0, 8000.0))
    unknown = np.full((360, 360), -9999.0, np.float32)
    for west in (119, 118):
        services.files[f"/cog/GLO30_N34_00_W{west}.tif"] = geotiff(
            unknown, "EPSG:4326", -west, 35.0, STEP, nodata=-9999.0
        )
    with pytest.raises(NoCoverageError):
        source.fetch(source.plan(AREA), tmp_path / "out", silent)
    assert not (tmp_path / "out").exists()


def test_an_area_beyond_the_border_gets_its_heights_from_the_next_source(
    services: SiteServices, tmp_path: Path
) -> None:
    unknown = np.full((360, 360), -9999.0, np.float32)
    services.files["/cog/USGS_13_n35w119.tif"] = geotiff(unknown, "EPSG:4269", -119, 35.0, STEP, nodata=-9999.0)
    area = area_around(-118.5, 34.5, 8000.0)
    listed = services.loaded(tmp_path)
    with pytest.raises(NoCoverageError, match="usgs_3dep_10m is not used"):
        choose("dem", area, listed).fetch(tmp_path / "out", silent)
    add_degree_tile(services, "GLO30_N34_00_W119", -119, 35, 0, 0.0)
    choice = choose("dem", area, services.loaded(tmp_path))
    fetched = choice.fetch(tmp_path / "out", silent)
    assert (choice.source.name, fetched.source) == ("usgs_3dep_10m", "copernicus_glo30")
    assert fetched.vertical_crs == "EPSG:3855"


@pytest.mark.parametrize("trouble", ["no ranges", "no GeoTIFF", "a mask", "busy"])
def test_a_file_server_that_fails_is_a_clear_error_and_leaves_nothing(
    trouble: str, services: SiteServices, tmp_path: Path
) -> None:
    add_degree_tile(services, "GLO30_N34_00_W119", -119, 35, 0, 0.0)
    area = area_around(-118.5, 34.5, 8000.0)
    source = named(services, tmp_path, "copernicus_glo30", resolution_m=277.0)
    if trouble == "no ranges":
        services.ranges = False
    elif trouble == "no GeoTIFF":
        services.files["/cog/GLO30_N34_00_W119.tif"] = b"<VRTDataset><SourceFilename>/etc/passwd</SourceFilename>" * 99
    elif trouble == "a mask":
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), MemoryFile() as memory:
            with memory.open(
                driver="GTiff", width=360, height=360, count=1, dtype="float32", crs="EPSG:4326",
                transform=rasterio.transform.from_origin(-119.0, 35.0, STEP, STEP),
            ) as sink:  # fmt: skip
                sink.write(np.ones((1, 360, 360), np.float32))
                sink.write_mask(np.eye(360, dtype=np.uint8) * 255)
            services.files["/cog/GLO30_N34_00_W119.tif"] = bytes(memory.getbuffer())
    else:
        services.statuses["/cog/"] = [503] * 10_000
    with pytest.raises(LtmError):
        source.fetch(source.plan(area), tmp_path / "out", silent)
    assert not (tmp_path / "out").exists()
    assert not list((tmp_path / "cache").glob("*.tif"))


def test_a_file_server_that_fails_a_few_times_is_asked_again(services: SiteServices, tmp_path: Path) -> None:
    add_degree_tile(services, "GLO30_N34_00_W119", -119, 35, 0, 0.0)
    source = named(services, tmp_path, "copernicus_glo30", resolution_m=277.0)
    services.statuses["/cog/"], services.retry_after = [503, 429], "0"
    plan = source.plan(area_around(-118.5, 34.5, 8000.0))
    services.cut["/cog/"] = 1
    (path,) = source.fetch(plan, tmp_path / "out", silent).files
    values, about = opened(path)
    assert values[0, 0] == pytest.approx(plane(*(about.transform * (0.5, 0.5))), abs=1e-4)


def test_web_map_tiles_have_the_names_and_values_of_their_places(services: SiteServices, tmp_path: Path) -> None:
    """Quadkey and bounds of the tile by the definition of web map tiles; values are canopy heights above the ground."""
    zoom, x, y = 10, 176, 408
    quadkey = "".join(str((x >> b & 1) + 2 * (y >> b & 1)) for b in range(zoom - 1, -1, -1))
    side = 2 * 20_037_508.342789244
    west, north, step = x * side / 2**zoom - side / 2, side / 2 - y * side / 2**zoom, side / 2**zoom / 512
    heights = np.where(np.arange(512) < 500, 7, 255).astype(np.uint8) * np.ones((512, 1), np.uint8)
    services.files[f"/cog/chm_{quadkey}.tif"] = geotiff(heights, "EPSG:3857", west, north, step)
    lon, lat = transform("EPSG:3857", "EPSG:4326", [west + 490 * step], [north - 256 * step])
    source = named(services, tmp_path, "meta_canopy_1m", resolution_m=76.0)
    area = area_around(lon[0], lat[0], 1500.0)
    fetched = source.fetch(source.plan(area), tmp_path / "out", silent)
    values, about = opened(fetched.files[0])
    assert set(np.unique(values)) == {7, 255}
    assert (about.nodata, fetched.above_ground, fetched.vertical_crs) == (255, True, None)
