import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from bystander import Bystander
from rasterio.enums import Resampling
from rasterio.transform import from_origin
from rasterio.warp import reproject
from scenes.site_services import SiteServices, geotiff, grid
from scenes.waiting import wait_for

from ltm_core.base.resources import project_path
from ltm_core.pipeline.stored_fuel import STORE_FILE
from ltm_core.site.site_io import load_site
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.grid import msg_to_classes
from ltm_ros.runtime.topics import FUEL_MAP_UPDATE, site_topic

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("kernels")]

README = Path(__file__).parents[2] / "README.md"
LTM = [sys.executable, "-c", "from ltm_ros.cli.main import app; app()"]
DEMO = project_path("bags/demo")
STEP = 1 / 10800
WEST, NORTH = -118.70, 34.24


def readme_lines() -> list[list[str]]:
    """The words of each line of the block with `ltm init`."""
    (block,) = [b for b in README.read_text(encoding="utf-8").replace("\\\n", " ").split("```") if "ltm init" in b]
    return [shlex.split(line, comments=True) for line in block.splitlines()[1:] if line.strip()]


def serve_terrain_of_the_demo(services: SiteServices) -> None:
    """The demo's ground as USGS and Copernicus would have it, in degrees."""
    with rasterio.open(DEMO / "dem.tif") as source:
        ground, crs, transform = source.read(1), source.crs, source.transform
    fine = np.full((900, 1100), -9999.0, np.float32)
    reproject(
        ground, fine, src_transform=transform, src_crs=crs, dst_transform=from_origin(WEST, NORTH, STEP, STEP),
        dst_crs="EPSG:4269", dst_nodata=-9999.0, resampling=Resampling.bilinear,
    )  # fmt: skip
    services.files["/cog/USGS_13_n35w119.tif"] = geotiff(fine, "EPSG:4269", WEST, NORTH, STEP, nodata=-9999.0)
    for south in (33, 34):
        for west in (118, 119, 120):
            lon, _ = grid(-west, south + 1, 1 / 400, 400, 400)
            flat = np.full(lon.shape, 500.0, np.float32) + np.float32(0.01) * np.arange(400, dtype=np.float32)
            services.files[f"/cog/GLO30_N{south}_00_W{west}.tif"] = geotiff(
                flat, "EPSG:4326", -west, south + 1, 1 / 400
            )


def test_the_readmes_lines_lead_to_a_fuel_map(ros_domain: int, tmp_path: Path) -> None:
    init, run = readme_lines()
    demo = load_site(DEMO / "site.yaml")
    lon, lat = (float(v) for v in demo.frame.to_lonlat(1560.0, 2490.0))  # the tower in the north, 20 m high
    convergence = demo.frame.grid_convergence_deg(1560.0, 2490.0)
    photos = tmp_path / "photos"
    photos.mkdir()
    bag = BagReader(DEMO / "recording")
    (photo, *_) = (bag.decode(m) for m in bag.messages(["/demo/tower_north/image_raw/compressed"]))
    # The place and the camera are the demo's, all else is the README's.
    init[init.index("--lonlat") + 1] = f"{lon:.7f},{lat:.7f}"
    camera = f"{lon:.7f},{lat:.7f},height=20,azimuth={165 + convergence:.3f},pitch=-8,hfov=56,photos=photos"
    init[init.index("--camera") + 1] = f"north={camera}"
    environment = os.environ | {
        "COLUMNS": "200", "XDG_CACHE_HOME": str(tmp_path / "cache"), "LANDFIRE_EMAIL": "a@b.c",
    }  # fmt: skip
    (photos / "first.jpg").write_bytes(bytes(photo.data))
    with SiteServices() as services:
        serve_terrain_of_the_demo(services)
        sources = services.sources(tmp_path / "sources.yaml")
        done = subprocess.run(
            [*LTM, *init[1:], "--radius", "2km", "--sources", str(sources)],
            cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "ridge/check.png").is_file()
    update = site_topic("ridge", FUEL_MAP_UPDATE)
    console = tmp_path / "console"
    with console.open("w") as said:
        with Bystander() as bystander:
            bystander.listen(update, FUEL_MAP_UPDATE.type)  # before the graph starts: one photo gives one update
            start = [*LTM, *run[1:]]
            graph = subprocess.Popen(start, cwd=tmp_path, env=environment, stdout=said, stderr=subprocess.STDOUT)
            try:
                wait_for(
                    lambda: bystander.heard[update],
                    "an update of the map",
                    lambda: (bystander.summaries, console.read_text()),
                    patience_s=240.0,
                )
            except BaseException:
                graph.kill()
                raise
        graph.send_signal(signal.SIGTERM)
        try:
            assert graph.wait(60) == 0
        finally:
            graph.kill()
            graph.wait()
    assert (tmp_path / "map" / STORE_FILE).is_file()
    classes, _ = msg_to_classes(bystander.heard[update][-1])
    assert (classes != 255).sum() > 100
