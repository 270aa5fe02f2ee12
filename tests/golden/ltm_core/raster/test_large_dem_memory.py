"""A DEM of 10 km x 10 km at 1 m, deflated, with holes: opened and traced within 0.9 GB of resident memory in all, by a
process that finds its kernels compiled, as every one after the first does.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ltm_lab.bench.mountains import ridged_terrain

SIDE = 10_000
MOST_MB = 900.0

CHILD = """
import json, sys
from ltm_lab.bench.measure import peak_mb
from ltm_lab.bench.mountains import ridged_terrain
from ltm_core.geometry.camera import Camera
from ltm_core.raster.dem import Dem
from ltm_core.geometry.pose import Pose
from ltm_core.tracing import TerrainTracer

def run(dem, camera):
    tracer = TerrainTracer(dem)
    x, y = dem.geometry.to_map(dem.geometry.height / 2, dem.geometry.width / 2)
    ground = float(dem.elevation_at(x, y))
    return tracer.trace(camera, Pose.from_angles((float(x), float(y), ground + 20.0), 41.0, -5.0, 2.0))

run(ridged_terrain(60), Camera.from_fov(320, 240, 60.0))  # compiles, where this machine has not yet
if sys.argv[1:]:
    dem = Dem.open(sys.argv[1])
    traced = run(dem, Camera.from_fov(1920, 1080, 60.0))
    hits = float((abs(traced.range) < 1e9).mean())
    print(json.dumps([peak_mb(), hits, list(dem.elevation.shape)]))
"""


def write(path: Path, dtype: str, nodata: float) -> None:
    import rasterio
    from rasterio.transform import from_origin
    from rasterio.windows import Window

    heights = ridged_terrain(SIDE).elevation
    heights[3000:3400, 2000:2600] = np.nan
    rng = np.random.default_rng(0)
    heights[rng.integers(0, SIDE, 4000), rng.integers(0, SIDE, 4000)] = np.nan
    heights[:300, :700] = np.nan
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=SIDE,
        height=SIDE,
        count=1,
        dtype=dtype,
        nodata=nodata,
        crs="EPSG:32611",
        transform=from_origin(3e5, 38e5, 1.0, 1.0),
        compress="deflate",
        zlevel=1,
        tiled=True,
        blockxsize=256,
        blockysize=256,
    ) as sink:
        for row in range(0, SIDE, 512):
            strip = heights[row : row + 512]
            sink.write(
                np.where(np.isnan(strip), nodata, strip).astype(dtype), 1, window=Window(0, row, SIDE, len(strip))
            )


@pytest.mark.slow
@pytest.mark.parametrize(("dtype", "nodata"), [("float32", float("nan")), ("float32", -9999.0), ("int16", -32768.0)])
def test_opened_and_traced_within_its_memory(tmp_path: Path, dtype: str, nodata: float) -> None:
    path = tmp_path / "large.tif"
    write(path, dtype, nodata)
    # A cache of its own, or an edit of the source beside this test would have the second child compile again.
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    subprocess.run([sys.executable, "-c", CHILD], check=True, env=environment)
    ran = subprocess.run(
        [sys.executable, "-c", CHILD, str(path)], check=True, capture_output=True, text=True, env=environment
    )
    peak, hits, shape = json.loads(ran.stdout)
    print(f"{dtype}, nodata {nodata}: {peak:.0f} MB at most")
    assert shape == [SIDE, SIDE]
    assert hits > 0.5
    assert peak < MOST_MB
