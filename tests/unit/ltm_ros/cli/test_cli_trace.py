from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from scenes.rasters import rough_terrain

from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_ros.cli.trace import trace

POSE = """
pose: {{x: 400060.5, y: 3799930.25, z: {z}, azimuth_deg: {azimuth}, pitch_deg: -12}}
calibration: {{width: 96, height: 60, hfov_deg: 55}}
"""


@pytest.fixture
def dem_file(tmp_path: Path) -> Path:
    geometry = GridGeometry(400_000.0, 3_800_000.0, 1.0, 263, 181, "EPSG:32611")
    Dem(rough_terrain(61).elevation, geometry).save(tmp_path / "dem.tif")
    return tmp_path / "dem.tif"


def pose_file(folder: Path, z: float, azimuth: float = 75.0) -> Path:
    path = folder / "pose.yaml"
    path.write_text(POSE.format(z=z, azimuth=azimuth))
    return path


def test_one_picture(tmp_path: Path, dem_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photo = tmp_path / "photo.png"
    cv2.imwrite(str(photo), np.full((60, 96, 3), 90, np.uint8))
    trace(dem=[dem_file], pose=pose_file(tmp_path, 890.0), out=tmp_path / "out" / "one", image=photo)
    names = {path.name for path in (tmp_path / "out" / "one").iterdir()}
    assert names == {
        "range.tif",
        "depth.tif",
        "horizontal.tif",
        "alignment.tif",
        "seen.tif",
        "depth.png",
        "map.png",
    }
    said = capsys.readouterr().out
    assert "DEM cells seen" in said
    assert "No pixel sees the terrain" not in said
    assert cv2.imread(str(tmp_path / "out" / "one" / "depth.png")).shape[1] == 96


def test_a_coarser_raster_around_it(tmp_path: Path, dem_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where the ray leaves the fine raster there is ground too: fewer pixels see nothing."""
    geometry = GridGeometry(399_000.0, 3_801_000.0, 10.0, 240, 230, "EPSG:32611")
    Dem(np.full(geometry.shape, 780.0, np.float32), geometry).save(tmp_path / "around.tif")
    seen = {}
    for name, rasters in (("alone", [dem_file]), ("stack", [dem_file, tmp_path / "around.tif"])):
        trace(dem=rasters, pose=pose_file(tmp_path, 890.0), out=tmp_path / name)
        with rasterio.open(tmp_path / name / "range.tif") as written:
            seen[name] = np.isfinite(written.read(1))
    assert not (seen["alone"] & ~seen["stack"]).any()
    assert seen["stack"].sum() > seen["alone"].sum()
    assert "dem.tif, around.tif" in capsys.readouterr().out
