import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import Transformer

from ltm_core.base.errors import ConfigError
from ltm_core.fuel.overlays_io import read_burns
from ltm_core.geometry.grid import GridGeometry

GRID = GridGeometry(480_000.0, 4_150_000.0, 30.0, 7, 5, "EPSG:26911")
"""Five rows of seven cells."""


def ring(left: float, top: float, right: float, bottom: float) -> list[list[float]]:
    """A rectangle from the grid's corner, in cells, as longitudes and latitudes."""
    turn = Transformer.from_crs(GRID.crs, "OGC:CRS84", always_xy=True)
    corners = ((left, top), (left, bottom), (right, bottom), (right, top), (left, top))
    return [list(turn.transform(GRID.x_min + 30 * col, GRID.y_max - 30 * row)) for col, row in corners]


def feature(moment: Any, kind: str, coordinates: Any) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": {"burned_at": moment, "name": "Ridge"},
        "geometry": {"type": kind, "coordinates": coordinates},
    }


def written(folder: Path, *features: Any) -> Path:
    path = folder / "burns.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def test_cells_of_which_half_has_burned(tmp_path: Path) -> None:
    """Columns 1 to 3 and 0.6 of column 4 of rows 1 and 2; a hole; another area of the same moment, and one far away."""
    areas = [[ring(1, 1, 4.6, 3), ring(2, 1, 3, 2)], [ring(-400, -400, -390, -390)]]
    path = written(
        tmp_path,
        feature("2026-08-02", "Polygon", [ring(6, 4, 7, 5)]),
        feature("2026-08-01T14:00:00.5+02:00", "MultiPolygon", areas),
        feature("2026-08-01T12:00:00.500Z", "Polygon", [ring(0, 0, 0.55, 1)]),
        feature("2026-08-03", "Polygon", [ring(90, 90, 95, 95)]),
    )
    first, second = read_burns(path, GRID)
    assert first.stamp_ns == 1_785_585_600_500_000_000
    expected = np.zeros(GRID.shape, bool)
    expected[1:3, 1:5] = True
    expected[1, 2], expected[0, 0] = False, True
    np.testing.assert_array_equal(first.mask(GRID.shape), expected)
    assert (second.stamp_ns, second.cells.tolist()) == (1_785_628_800_000_000_000, [4 * 7 + 6])


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        (feature(None, "Polygon", [ring(0, 0, 1, 1)]), "write when it burned"),
        (feature("yesterday", "Polygon", [ring(0, 0, 1, 1)]), "'yesterday'; write when it burned"),
        (feature("1969-01-01", "Polygon", [ring(0, 0, 1, 1)]), "1970 to 2105"),
        (feature("2107-01-01", "Polygon", [ring(0, 0, 1, 1)]), "1970 to 2105"),
        (feature("2026-08-01", "Polygon", [[[y, x] for x, y in ring(0, 0, 1, 1)]]), "longitude, latitude"),
        (feature("2026-08-01", "Polygon", [[[float("nan"), 30.0]] * 4]), "longitude, latitude"),
        (feature("2026-08-01", "Polygon", [[[10**400, 30.0]] * 4]), "feature 0"),
        (feature("2026-08-01", "Polygon", []), "without a ring"),
        (feature("2026-08-01", "Point", [1.0, 2.0]), "is a Point"),
        (feature("2026-08-01", "Polygon", [[[1.0, 2.0]] * 3]), "feature 0: 3 points"),
        (feature("2026-08-01", "Polygon", [[["a", 2.0]] * 4]), "feature 0"),
        ({"properties": {"burned_at": "2026-08-01"}}, "feature 0"),
        (17, "feature 0"),
    ],
)
def test_what_is_no_burn_is_refused(tmp_path: Path, wrong: Any, why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        read_burns(written(tmp_path, wrong), GRID)


@pytest.mark.parametrize("content", ["", "[1]", '{"type": "FeatureCollection"}', "[" * 100_000])
def test_what_is_no_geojson_is_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / "burns.geojson"
    path.write_text(content)
    with pytest.raises(ConfigError, match="cannot be read as GeoJSON"):
        read_burns(path, GRID)
