"""Vector layers of roads, water and buildings as non-burnable cells."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import Transformer

from ltm_core.base.errors import ConfigError
from ltm_core.base.strict_model import beside
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.overlays_io import BarrierConfig
from ltm_core.fuel.prior import PriorConfig, load_prior
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


def degrees(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    turn = Transformer.from_crs("EPSG:32611", "OGC:CRS84", always_xy=True)
    return [turn.transform(*point) for point in points]


def geojson(path: Path, *shapes: tuple[str, Any]) -> Path:
    geometries = [{"type": kind, "coordinates": coordinates} for kind, coordinates in shapes]
    features = [{"type": "Feature", "properties": {}, "geometry": shape} for shape in (None, *geometries)]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def test_areas_by_the_share_of_the_cell_and_lines_without_gaps(tmp_path: Path) -> None:
    areas = [[degrees(box(1, 1, 1.6, 1)[0])], [degrees(box(5, 3, 2, 2)[0])]]
    lakes = geojson(tmp_path / "lakes.geojson", ("MultiPolygon", areas))
    road = [(300_000 + 5, 3_700_000 - 140), (300_000 + 205, 3_700_000 - 10)]
    roads = geojson(tmp_path / "roads.geojson", ("LineString", degrees(road)))
    barriers = (BarrierConfig(path=roads, kind="road"), BarrierConfig(path=lakes, kind="water"))
    prior = load_prior(PriorConfig(path=fuels(tmp_path), barriers=barriers), GRID)
    water = prior.codes == 98
    assert set(zip(*np.nonzero(water), strict=True)) == {(1, 1), (1, 2), (3, 5), (3, 6), (4, 5)}
    assert prior.codes[4, 6] == NODATA
    on_road = prior.codes == 91
    assert on_road.sum() >= 9
    # No fire passes between two cells of it: each has a neighbour by its side, not by its corner alone.
    cells = set(zip(*np.nonzero(on_road | water), strict=True))
    assert all(any((r + a, c + b) in cells for a, b in ((0, 1), (1, 0), (0, -1), (-1, 0))) for r, c in cells)


def test_paths_are_taken_from_the_site_file(tmp_path: Path) -> None:
    config = PriorConfig.model_validate({"path": "f.tif", "barriers": [{"path": "r.geojson", "kind": "road"}]})
    assert beside(config, tmp_path).barriers[0].path == tmp_path / "r.geojson"


def test_what_cannot_be_read_is_named(tmp_path: Path) -> None:
    (tmp_path / "b.geojson").write_bytes(b"no JSON")
    metres = geojson(tmp_path / "m.geojson", ("LineString", [(300_000.0, 3_700_000.0), (300_100.0, 3_700_000.0)]))
    curve = geojson(tmp_path / "c.geojson", ("CircularString", [(0.0, 0.0), (1.0, 1.0)]))
    for path in (tmp_path / "b.geojson", metres, curve, tmp_path / "d.geojson"):
        with pytest.raises(ConfigError, match=path.name):
            load_prior(PriorConfig(path=fuels(tmp_path), barriers=(BarrierConfig(path=path, kind="road"),)), GRID)


def test_elmfires_buildings(tmp_path: Path) -> None:
    codes = np.full(GRID.shape, 102, np.int16)
    codes[1, 2], codes[3, 3] = 256, 37
    write_geotiff(tmp_path / "b.tif", codes, GRID, nodata=NODATA)
    for how, code in (("built", 91), ("keep", 256), ("nodata", NODATA)):
        prior = load_prior(PriorConfig(path=tmp_path / "b.tif", unknown_codes=how), GRID)  # type: ignore[arg-type]
        assert (prior.codes[1, 2], prior.codes[3, 3]) == (code, 37)
