from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes.geopackages import add_layer, area, line, several

from ltm_core.base.errors import RasterError
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.prior import BarrierConfig, PriorConfig
from ltm_core.fuel.prior_io import load_prior
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import write_geotiff

GRID = GridGeometry(300_000.0, 3_700_000.0, 30.0, 7, 5, "EPSG:32611")


def box(col: float, row: float, width: float, height: float) -> list[list[tuple[float, float]]]:
    x, y = 300_000 + 30 * col, 3_700_000 - 30 * row
    return [[(x, y), (x + 30 * width, y), (x + 30 * width, y - 30 * height), (x, y - 30 * height), (x, y)]]


def fuels(folder: Path) -> Path:
    codes = np.full(GRID.shape, 102, np.int16)
    codes[4, 6] = NODATA
    write_geotiff(folder / "fuels.tif", codes, GRID, nodata=NODATA)
    return folder / "fuels.tif"


def test_areas_by_the_share_of_the_cell_and_lines_without_gaps(tmp_path: Path) -> None:
    path = add_layer(
        tmp_path / "a.gpkg", "lakes", [None, several(6, [area(box(1, 1, 1.6, 1)), area(box(5, 3, 2, 2), ">")])]
    )
    road = [(300_000 + 5, 3_700_000 - 140), (300_000 + 205, 3_700_000 - 10)]
    add_layer(path, "roads", [line(road)])
    barriers = (
        BarrierConfig(path=path, layer="roads", kind="road"),
        BarrierConfig(path=path, layer="lakes", kind="water"),
    )
    prior = load_prior(PriorConfig(path=fuels(tmp_path), barriers=barriers), GRID)
    water = prior.codes == 98
    assert set(zip(*np.nonzero(water), strict=True)) == {(1, 1), (1, 2), (3, 5), (3, 6), (4, 5)}
    assert prior.codes[4, 6] == NODATA
    on_road = prior.codes == 91
    assert on_road.sum() >= 9
    # No fire passes between two cells of it: each has a neighbour by its side, not by its corner alone.
    cells = set(zip(*np.nonzero(on_road | water), strict=True))
    assert all(any((r + a, c + b) in cells for a, b in ((0, 1), (1, 0), (0, -1), (-1, 0))) for r, c in cells)


def test_a_layer_in_another_crs(tmp_path: Path) -> None:
    from pyproj import Transformer

    turn = Transformer.from_crs("EPSG:32611", "EPSG:4326", always_xy=True)
    ring = [turn.transform(*point) for point in box(2, 2, 1, 1)[0]]
    path = add_layer(tmp_path / "a.gpkg", "houses", [area([ring])], 4326)
    barrier = BarrierConfig(path=path, kind="built")
    prior = load_prior(PriorConfig(path=fuels(tmp_path), barriers=(barrier,)), GRID)
    assert [tuple(cell) for cell in np.argwhere(prior.codes == 91).tolist()] == [(2, 2)]


def test_what_cannot_be_read_is_named(tmp_path: Path) -> None:
    path = add_layer(tmp_path / "a.gpkg", "lakes", [area(box(1, 1, 1, 1))])
    arcs = add_layer(tmp_path / "e.gpkg", "a", [b"\x01\x08\x00\x00\x00" + bytes(20)])
    (tmp_path / "b.gpkg").write_bytes(b"no database")
    for barrier, message in (
        (BarrierConfig(path=path, layer="rivers", kind="water"), r"a.gpkg: no layer .rivers.; it has the layers lakes"),
        (BarrierConfig(path=add_layer(tmp_path / "d.gpkg", "a", [], -1), kind="road"), r"d.gpkg: .* no known CRS"),
        (BarrierConfig(path=arcs, kind="road"), r"e.gpkg: .*geometry type 8"),
        (BarrierConfig(path=tmp_path / "b.gpkg", kind="water"), r"b.gpkg: cannot be read as a GeoPackage"),
        (BarrierConfig(path=tmp_path / "c.gpkg", kind="water"), r"c.gpkg: no such file"),
    ):
        with pytest.raises(RasterError, match=message):
            load_prior(PriorConfig(path=fuels(tmp_path), barriers=(barrier,)), GRID)


def test_elmfires_buildings(tmp_path: Path) -> None:
    codes = np.full(GRID.shape, 102, np.int16)
    codes[1, 2], codes[3, 3] = 256, 37
    write_geotiff(tmp_path / "b.tif", codes, GRID, nodata=NODATA)
    for how, code in (("built", 91), ("keep", 256), ("nodata", NODATA)):
        prior = load_prior(PriorConfig(path=tmp_path / "b.tif", unknown_codes=how), GRID)  # type: ignore[arg-type]
        assert (prior.codes[1, 2], prior.codes[3, 3]) == (code, 37)
