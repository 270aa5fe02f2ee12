import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from PIL import Image
from scenes.rasters import rough_terrain

from ltm_core.base.errors import ConfigError, ImageError, PoseError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.trace_io import (
    PictureConfig,
    cell_counts,
    load_picture_config,
    read_photo,
    set_up_picture,
    write_trace,
)

POSE = """
calibration: {width: 64, height: 40, hfov_deg: 55}
pose:
  x: 400060.5
  y: 3799930.25
  height_above_ground: 14
  azimuth_deg: 75
  pitch_deg: -12
  roll_deg: 2
"""


@pytest.fixture
def dem() -> Dem:
    terrain = rough_terrain(41, x_min=400_000.0, y_max=3_800_000.0)
    return Dem(terrain.elevation, GridGeometry(400_000.0, 3_800_000.0, 1.0, 263, 181, "EPSG:32611"))


def config_of(tmp_path: Path, text: str) -> PictureConfig:
    path = tmp_path / "pose.yaml"
    path.write_text(text)
    return load_picture_config(path)


def test_the_camera_stands_above_the_ground_in_a_near_frame(tmp_path: Path, dem: Dem) -> None:
    setup = set_up_picture(config_of(tmp_path, POSE), dem)
    assert (setup.frame.x_origin, setup.frame.y_origin) == (400_000.0, 3_800_000.0)
    np.testing.assert_allclose(setup.pose.position[:2], [60.5, -69.75])
    ground = float(dem.elevation_at(400_060.5, 3_799_930.25))
    assert setup.pose.position[2] == pytest.approx(ground + 14)
    np.testing.assert_allclose(setup.pose.angles_deg, [75, -12, 2], atol=1e-9)
    assert setup.camera == Camera.from_fov(64, 40, 55)


def test_refuses_positions_it_cannot_place(tmp_path: Path, dem: Dem) -> None:
    beside = POSE.replace("400060.5", "399000")
    with pytest.raises(PoseError, match=r"camera at \(399000, 3799930.25\): .*check position.*x 400000 to 400263"):
        set_up_picture(config_of(tmp_path, beside), dem)
    with pytest.raises(ConfigError, match="EPSG:999999"):
        set_up_picture(config_of(tmp_path, POSE + "  crs: EPSG:999999\n"), dem)
    swapped = POSE.replace("400060.5", "34").replace("3799930.25", "-118") + "  crs: EPSG:4326"
    with pytest.raises(PoseError, match="longitude first"):
        set_up_picture(config_of(tmp_path, swapped), dem)


def test_a_photo_that_exif_turns_says_so(tmp_path: Path) -> None:
    image = Image.fromarray(np.zeros((40, 64, 3), np.uint8))
    exif = image.getexif()
    exif[0x0112] = 6
    image.save(tmp_path / "portrait.jpg", exif=exif.tobytes())
    with pytest.raises(ImageError, match=r"photo of 40 x 64 pixels, upright as EXIF turns its 64 x 40, .* 64 x 40"):
        read_photo(tmp_path / "portrait.jpg", Camera.from_fov(64, 40, 50.0))
    assert read_photo(tmp_path / "portrait.jpg", Camera.from_fov(40, 64, 50.0)).shape == (64, 40, 3)


def test_rasters_hold_the_trace(tmp_path: Path, dem: Dem) -> None:
    setup = set_up_picture(config_of(tmp_path, POSE), dem)
    traced = TerrainTracer(setup.dem).trace(setup.camera, setup.pose)
    written = write_trace(tmp_path / "out", traced, setup.frame)
    assert sorted(p.name for p in written) == ["alignment.tif", "depth.tif", "horizontal.tif", "range.tif", "seen.tif"]
    for name, values in (("range", traced.range), ("depth", traced.depth()), ("horizontal", traced.horizontal())):
        with rasterio.open(tmp_path / "out" / f"{name}.tif") as source:
            np.testing.assert_array_equal(source.read(1), values)
            assert np.isnan(source.nodata)
            assert "m" in source.descriptions[0]
            pose = json.loads(source.tags()["LTM_POSE"])
            assert pose["position"][:2] == pytest.approx([400_060.5, 3_799_930.25])
            assert json.loads(source.tags()["LTM_CAMERA"])["width"] == 64
            assert source.tags()["LTM_CRS"] == "EPSG:32611"
    with rasterio.open(tmp_path / "out" / "alignment.tif") as source:
        x, y, z = source.read()
    seen = np.isfinite(traced.range)
    assert seen.mean() > 0.3
    assert np.isnan(x[~seen]).all()
    np.testing.assert_allclose(z[seen], dem.elevation_at(x[seen], y[seen]), atol=2e-3)


def test_seen_cells_lie_on_the_dem(tmp_path: Path, dem: Dem) -> None:
    setup = set_up_picture(config_of(tmp_path, POSE), dem)
    traced = TerrainTracer(setup.dem).trace(setup.camera, setup.pose)
    write_trace(tmp_path, traced, setup.frame)
    counts = cell_counts(traced)
    assert counts.sum() == np.isfinite(traced.range).sum()
    row, col = traced.cells()[30, 20]
    assert counts[row, col] >= 1
    with rasterio.open(tmp_path / "seen.tif") as source:
        np.testing.assert_array_equal(source.read(1), counts)
        assert source.crs.to_epsg() == 32611
        assert tuple(source.bounds) == dem.geometry.bounds
