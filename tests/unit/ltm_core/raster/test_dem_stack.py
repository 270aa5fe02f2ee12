from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pyproj import Transformer
from scenes.rasters import rough_terrain

from ltm_core.base.errors import RasterError
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.raster.dem_stack import BAND, REACH, DemStack, with_surface
from ltm_core.site.site_io import load_site

pytestmark = pytest.mark.kernel

UTM = "EPSG:32611"


def coarse_terrain(resolution: float = 10.0) -> Dem:
    return rough_terrain(1, (60, 80), resolution=resolution, relief=150.0, x_min=-400.0, y_max=300.0)


def fine_terrain(coarse: Dem, offset: float = 0.0, shape: tuple[int, int] = (170, 230)) -> Dem:
    geometry = GridGeometry(-103.3, 81.7, 1.0, shape[1], shape[0])
    row, col = np.mgrid[0 : shape[0], 0 : shape[1]]
    detail = rough_terrain(2, shape, relief=6.0).elevation - 803.0
    return Dem((coarse.elevation_at(*geometry.to_map(row, col)) + detail + offset).astype(np.float32), geometry)


def test_the_border_is_the_coarser_surface_and_the_inside_is_untouched() -> None:
    coarse = coarse_terrain()
    fine = fine_terrain(coarse, offset=25.0)
    before = fine.elevation.copy()
    stack = DemStack([fine, coarse])
    np.testing.assert_array_equal(fine.elevation, before)
    row, col = np.mgrid[0:170, 0:230]
    x, y = fine.geometry.to_map(row, col)
    edge = np.minimum(np.minimum(row, 169 - row), np.minimum(col, 229 - col))
    there = coarse.elevation_at(x, y)
    np.testing.assert_allclose(stack.elevation[edge == 0], there[edge == 0], atol=1e-4)
    band = BAND * 10.0
    np.testing.assert_array_equal(stack.elevation[edge >= band], before[edge >= band])
    expected = before + (1 - edge / band) * (there - before)
    np.testing.assert_allclose(stack.elevation[edge < band], expected[edge < band], atol=1e-3)


def test_holes_take_the_coarser_surface_moved_to_their_rim() -> None:
    coarse = coarse_terrain()
    fine = fine_terrain(coarse)
    offset = 7.5
    row, col = np.mgrid[0:170, 0:230]
    there = coarse.elevation_at(*fine.geometry.to_map(row, col)).astype(np.float32)
    holed = Dem(there + np.float32(offset), fine.geometry)
    lake = ((row - 80) / 20.0) ** 2 + ((col - 120) / 31.0) ** 2 < 1
    speck, margin = (row == 60) & (col == 40), col < 60 - row
    holed.elevation[lake | speck | margin] = np.nan
    stack = DemStack([holed, coarse])
    assert np.isfinite(stack.elevation).all()
    # The difference is the same all around, so the hole takes it whole.
    np.testing.assert_allclose(stack.elevation[lake | speck], (there + offset)[lake | speck], atol=2e-4)
    # At the margin it fades out towards the raster's edge.
    left = stack.elevation[margin] - there[margin]
    assert left.min() > -1e-3
    assert left.max() < offset
    assert np.abs(left[np.minimum(row, col)[margin] == 0]).max() < 1e-3


def test_what_neither_level_knows_stays_unknown() -> None:
    coarse = coarse_terrain()
    coarse.elevation[25:30, 35:45] = np.nan
    fine = fine_terrain(coarse_terrain())
    fine.elevation[60:130, 90:160] = np.nan
    stack = DemStack([fine, coarse])
    row, col = np.mgrid[0:170, 0:230]
    unknown = np.isnan(coarse.elevation_at(*fine.geometry.to_map(row, col)))
    lake = np.zeros((170, 230), np.bool_)
    lake[60:130, 90:160] = True
    np.testing.assert_array_equal(np.isnan(stack.elevation), unknown & lake)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda fine, coarse: [coarse], "at least one coarser"),
        (lambda fine, coarse: [coarse, fine], "from fine to coarse"),
        (lambda fine, coarse: [Dem(fine.elevation, fine.geometry.translated(600.0, 0.0)), coarse], "reaches beyond"),
        (lambda fine, coarse: [Dem(fine.elevation, fine.geometry.translated(0, 0, UTM)), coarse], "one CRS"),
    ],
)
def test_refused(change: Any, message: str) -> None:
    coarse = coarse_terrain()
    with pytest.raises(RasterError, match=message):
        DemStack(change(fine_terrain(coarse), coarse))


def write_site(folder: Path, dem: Any, **more: Any) -> Path:
    site = {"name": "far", "crs": UTM, "origin": [400_000, 3_800_000], "dem": dem, "cameras": {"north": {}}, **more}
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(site))
    return path


def write_levels(folder: Path, coarse_crs: str = UTM) -> tuple[Dem, Dem]:
    """A fine.tif of 1 m, and a coarse.tif over 120 x 100 km of one smooth surface, in UTM or degrees."""
    import rasterio
    from rasterio.transform import from_origin

    def surface(x: Any, y: Any) -> Any:
        return 800 + 300 * np.sin((x - 4e5) / 9000) * np.cos((y - 38e5) / 7000)

    fine_geometry = GridGeometry(399_900.0, 3_800_080.0, 1.0, 230, 170, UTM)
    row, col = np.mgrid[0:170, 0:230]
    fine = Dem(surface(*fine_geometry.to_map(row, col)).astype(np.float32), fine_geometry)
    fine.save(folder / "fine.tif")
    if coarse_crs == UTM:
        geometry = GridGeometry(340_000.0, 3_850_000.0, 100.0, 1200, 1000, UTM)
        row, col = np.mgrid[0:1000, 0:1200]
        Dem(surface(*geometry.to_map(row, col)).astype(np.float32), geometry).save(folder / "coarse.tif")
    else:
        transform = from_origin(-118.7, 34.8, 0.001, 0.001)
        lon, lat = np.meshgrid(-118.7 + 0.001 * (np.arange(1300) + 0.5), 34.8 - 0.001 * (np.arange(950) + 0.5))
        heights = surface(*Transformer.from_crs(coarse_crs, UTM, always_xy=True).transform(lon, lat))
        kw: dict[str, Any] = {"driver": "GTiff", "width": 1300, "height": 950, "count": 1, "crs": coarse_crs}
        with rasterio.open(folder / "coarse.tif", "w", dtype="int16", nodata=-1, transform=transform, **kw) as sink:
            sink.write(heights.round().astype(np.int16), 1)
    return fine, Dem(fine.elevation, fine.geometry)


@pytest.mark.parametrize("crs", [UTM, "EPSG:4326"])
def test_a_site_with_a_coarser_raster_around_it(tmp_path: Path, crs: str) -> None:
    fine, _ = write_levels(tmp_path, crs)
    dem = load_site(write_site(tmp_path, [{"path": "fine.tif"}, {"path": "coarse.tif"}])).open_dem()
    assert isinstance(dem, DemStack)
    x_min, y_min, x_max, y_max = dem.levels[1].geometry.bounds
    own = dem.geometry
    reach = (own.x_min - x_min, own.y_min - y_min, x_max - own.x_max, y_max - own.y_max)
    assert all(REACH <= r < REACH + 300 for r in reach)
    rng = np.random.default_rng(4)
    x, y = rng.uniform(-35_000, 35_000, 400), rng.uniform(-35_000, 35_000, 400)
    expected = 800 + 300 * np.sin(x / 9000) * np.cos(y / 7000)
    # Heights in whole metres, warped.
    assert np.abs(dem.elevation_at(x, y) - expected).max() < (0.1 if crs == UTM else 1.0)
    inner = rng.uniform(-60, 60, (2, 50)) + np.array([[15.0], [-5.0]])
    near = fine.elevation_at(inner[0] + 4e5, inner[1] + 38e5)
    assert np.abs(dem.elevation_at(*inner) - near).max() < (0.05 if crs == UTM else 1.0)


def canopy_over(ground: Dem, x_min: float, y_max: float, shape: tuple[int, int]) -> Dem:
    """Trees of 20 m on the western half of a patch; nodata on a clearing."""
    geometry = GridGeometry(x_min, y_max, 1.0, shape[1], shape[0], ground.geometry.crs)
    row, col = np.mgrid[0 : shape[0], 0 : shape[1]]
    tops = ground.elevation_at(*geometry.to_map(row, col)) + np.where(col < shape[1] / 2, 20.0, 0.0)
    tops[30:40, 10:20] = np.nan
    return Dem(tops.astype(np.float32), geometry)


def test_tree_tops_over_a_part_of_the_ground() -> None:
    coarse = coarse_terrain()
    ground = DemStack([fine_terrain(coarse), coarse])
    canopy = canopy_over(ground, -50.0, 40.0, (70, 90))
    surface = with_surface(ground, canopy)
    assert len(surface.levels) == 3
    assert float(surface.elevation_at(-20, -10) - ground.elevation_at(-20, -10)) == pytest.approx(20.0, abs=0.1)
    clearing = surface.elevation[30:40, 10:20]
    row, col = np.mgrid[30:40, 10:20]
    np.testing.assert_allclose(clearing, ground.elevation_at(*canopy.geometry.to_map(row, col)), atol=1e-4)
    assert float(surface.elevation_at(100.0, -60.0)) == float(ground.elevation_at(100.0, -60.0))
    assert np.isnan(canopy.elevation).sum() == 100


def test_a_site_with_a_surface(tmp_path: Path) -> None:
    fine, _ = write_levels(tmp_path)
    canopy_over(fine, 399_930.0, 3_800_050.0, (70, 90)).save(tmp_path / "tops.tif")
    site = load_site(write_site(tmp_path, [{"path": "fine.tif"}, {"path": "coarse.tif"}], surface={"path": "tops.tif"}))
    ground = site.open_dem()
    surface = site.open_surface(ground)
    at = (-40.0, 0.0)
    assert float(surface.elevation_at(*at) - ground.elevation_at(*at)) == pytest.approx(20.0, abs=0.05)
    bare = load_site(write_site(tmp_path, {"path": "fine.tif"}))
    ground = bare.open_dem()
    assert bare.open_surface(ground) is ground
