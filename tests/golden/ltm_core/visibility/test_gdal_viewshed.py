"""Lines of sight against GDAL's own viewshed, earth curvature and refraction on."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import rasterio

from ltm_core.base.types import BoolArray
from ltm_core.raster.dem import Dem
from ltm_core.visibility.point_visibility import TOLERANCE, PointVisibility

pytestmark = pytest.mark.slow


def gdal_seen(dem: Dem, row: int, col: int, above: float, folder: Path) -> BoolArray:
    """What GDAL sees from `above` metres over a cell's centre, (H, W). Its -cc is 1 - k."""
    program = shutil.which("gdal_viewshed")
    if program is None:
        pytest.skip("needs gdal_viewshed (Debian: apt-get install gdal-bin)")
    dem.save(folder / "dem.tif")
    x, y = (str(float(v)) for v in dem.geometry.to_map(row, col))
    options = f"-q -md 0 -ox {x} -oy {y} -oz {above} -tz 0 -cc 0.87 -vv 1 -iv 0".split()
    subprocess.run([program, *options, str(folder / "dem.tif"), str(folder / "seen.tif")], check=True)
    with rasterio.open(folder / "seen.tif") as source:
        seen: BoolArray = source.read(1) > 0
    assert seen.shape == dem.geometry.shape
    return seen


def our_seen(dem: Dem, row: int, col: int, above: float, curvature: bool = True) -> BoolArray:
    rows, cols = np.mgrid[0 : dem.geometry.height, 0 : dem.geometry.width]
    x, y = dem.geometry.to_map(rows, cols)
    points = np.stack([x, y, dem.elevation], axis=-1).reshape(-1, 3)
    origin = points[row * dem.geometry.width + col] + (0, 0, above)
    lift, unknown = PointVisibility(dem, curvature).lifts(origin, points)
    return ((lift <= TOLERANCE) & ~unknown).reshape(dem.geometry.shape)


@pytest.mark.parametrize(("row", "col", "above"), [(None, None, 10.0), (321, 399, 30.0), (500, 1000, 20.0)])
def test_mountains(shared_data: Path, tmp_path: Path, row: int | None, col: int | None, above: float) -> None:
    dem = Dem.open(shared_data / "dem_bigtujunga" / "bigtujunga.tif")
    if row is None or col is None:
        row, col = divmod(int(np.nanargmax(dem.elevation)), dem.geometry.width)  # the summit
    theirs, ours = gdal_seen(dem, row, col, above, tmp_path), our_seen(dem, row, col, above)
    agreement = float((theirs == ours).mean())
    print(f"agreement {agreement:.4%}, seen: ours {ours.mean():.2%}, GDAL {theirs.mean():.2%}")
    assert 0.02 < theirs.mean() < 0.9
    assert agreement >= 0.99
    # Where little is seen, most cells agree cheaply: of those that either sees, both see nearly all.
    common = (theirs & ours).sum() / (theirs | ours).sum()
    print(f"of the cells that either sees, both see {common:.1%}")
    assert common > 0.88
