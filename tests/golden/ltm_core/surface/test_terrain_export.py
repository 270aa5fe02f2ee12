"""`ltm export` of a living terrain, read by GDAL."""

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import yaml
from typer.testing import CliRunner

from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.site.site_io import load_site
from ltm_core.storage.tile_store import TileStore
from ltm_core.storage.tile_store_schema import FrameRecord
from ltm_core.surface.cell_layout import FIELDS, TILE
from ltm_core.surface.change import ChangeKind
from ltm_core.surface.tile_pool import schema_of
from ltm_ros.cli.main import cli

GRID = GridGeometry(346_000.0, 3_783_000.0, 2.0, 150, 310, "EPSG:32611")
FELLED = np.s_[280:290, 70:82]
"""Rows beyond the first strip that is written, in the second column of tiles."""
MEASURED = np.s_[270:300, 66:100]
FIRST, LAST = 1_718_000_000, 1_718_090_000


def ground() -> np.ndarray[Any, np.dtype[np.float32]]:
    row, col = np.mgrid[0 : GRID.height, 0 : GRID.width]
    return (500 + 0.3 * row + 0.1 * col).astype(np.float32)


@pytest.fixture
def site_file(tmp_path: Path) -> Path:
    """A site with 12 m of trees on its surface, and a store in which a part of them is gone."""
    Dem(ground(), GRID).save(tmp_path / "dem.tif")
    Dem(ground() + 12, GRID).save(tmp_path / "trees.tif")
    site = {"name": "ridge", "crs": GRID.crs, "origin": [346_000, 3_782_000], "terrain": {}}
    site |= {"dem": {"path": "dem.tif"}, "surface": {"path": "trees.tif"}, "cameras": {"north": {}, "east": {}}}
    (tmp_path / "site.yaml").write_text(yaml.safe_dump(site))
    whole = {name: np.zeros(GRID.shape, field.dtype) for name, field in FIELDS.items()}
    for name, value in {"looks": 4, "weight": 16, "relative_variance": 0.2, "frames": 4, "cameras": 3}.items():
        whole[name][MEASURED] = value
    whole["first"][MEASURED], whole["last"][MEASURED] = FIRST, LAST
    for name, value in {"dz": -11.5, "shift": -11.25, "kind": ChangeKind.REMOVED, "since": LAST}.items():
        whole[name][FELLED] = value
    tiles = {}
    for key in ((4, 1),):
        part = np.s_[key[0] * TILE : (key[0] + 1) * TILE, key[1] * TILE : (key[1] + 1) * TILE]
        tiles[key] = {
            name: np.pad(values[part], [(0, TILE - n) for n in values[part].shape]) for name, values in whole.items()
        }
    with TileStore.open(tmp_path / "terrain.sqlite", schema_of(GRID)) as store:
        store.commit(tiles, [FrameRecord("north", LAST * 10**9, [(4, 1)])])
    return tmp_path / "site.yaml"


def export(site_file: Path, what: str, *more: str) -> Path:
    out = site_file.parent / f"{what}.tif"
    arguments = [str(site_file.parent / "terrain.sqlite"), "--site", str(site_file), "--out", str(out)]
    result = CliRunner().invoke(cli, ["export", *arguments, "--format", what, *more], catch_exceptions=False)
    assert result.exit_code == 0
    assert "150 x 310 cells of 2 m, EPSG:32611" in result.output
    return out


def test_change_as_gdal_reads_it(site_file: Path) -> None:
    with rasterio.open(export(site_file, "change")) as source:
        assert (source.crs, source.transform) == (rasterio.CRS.from_string("EPSG:32611"), GRID.transform())
        assert source.descriptions == ("shift", "sigma", "kind", "since")
        assert source.units == ("m", "m", "1", "days since 1970-01-01 UTC")
        assert np.isnan(source.nodata)
        tags = source.tags()
        shift, sigma, kind, since = source.read()
    assert tags["as_of"] == datetime.fromtimestamp(LAST, UTC).isoformat()
    assert json.loads(tags["kinds"])["removed"] == int(ChangeKind.REMOVED)
    assert json.loads(tags["cameras"]) == list(load_site(site_file).cameras)
    looked = np.zeros(GRID.shape, bool)
    looked[MEASURED] = True
    gone = np.zeros(GRID.shape, bool)
    gone[FELLED] = True
    assert np.array_equal(np.isfinite(shift), looked)
    assert np.array_equal(np.isfinite(sigma), looked)
    assert (shift[gone] == -11.25).all()
    assert (shift[looked & ~gone] == 0).all()
    assert np.array_equal(kind == ChangeKind.REMOVED, gone)
    assert (kind[looked & ~gone] == 0).all()
    assert np.array_equal(np.isfinite(since), gone)
    assert since[280, 75] == pytest.approx(LAST / 86_400, abs=0.002)
    assert 0.1 < sigma[280, 75] < 1.0


def test_the_surface_is_that_of_the_site_with_its_changes(site_file: Path) -> None:
    with rasterio.open(export(site_file, "surface")) as source:
        assert (source.descriptions, source.units) == (("height", "sigma"), ("m", "m"))
        height, sigma = source.read()
    expected = ground() + 12
    expected[FELLED] -= 11.25
    np.testing.assert_allclose(height, expected, atol=1e-3)
    assert np.isnan(sigma[0, 0])
    assert np.isfinite(sigma[280, 75])
