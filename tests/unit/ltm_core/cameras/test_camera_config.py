from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ltm_core.base.errors import ConfigError, PoseError
from ltm_core.cameras.camera_config import PartialPose, PoseConfig
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame, magnetic_declination_deg
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import pose_covariance
from ltm_core.raster.dem import Dem
from ltm_core.site.site_io import load_site
from ltm_core.storage.config_io import load_yaml
from ltm_core.tracing.trace_io import PictureConfig, load_picture_config
from ltm_ros.recordings.importing.photo import read_pose_file

FRAME = SiteFrame("EPSG:32611", 402_000.0, 3_787_000.0)
POSE = {"x": 402_310.0, "y": 3_787_120.0, "z": 912.5, "azimuth_deg": 214.0, "pitch_deg": -4.0, "roll_deg": 1.5}
CALIBRATION = {"width": 64, "height": 40, "fx": 81.0, "cx": 30.0, "cy": 21.0, "k1": -0.1, "p2": 0.002}
CAMERA = Camera(64, 40, 81.0, 81.0, 30.0, 21.0, (-0.1, 0.0, 0.0, 0.002, 0.0))


def test_a_section_is_the_same_in_every_file(tmp_path: Path) -> None:
    sections = {"pose": POSE, "calibration": CALIBRATION}
    site = {"name": "ridge", "crs": "EPSG:32611", "origin": [402_000, 3_787_000], "dem": {"path": "dem.tif"}}
    (tmp_path / "site.yaml").write_text(yaml.safe_dump(site | {"cameras": {"north": sections}}))
    (tmp_path / "pose.yaml").write_text(yaml.safe_dump(sections))
    flat = POSE | CALIBRATION
    (tmp_path / "photos.csv").write_text(f"name,{','.join(flat)}\na.jpg,{','.join(map(str, flat.values()))}\n")
    fixed = load_site(tmp_path / "site.yaml").camera("north")
    picture = load_picture_config(tmp_path / "pose.yaml")
    listed = read_pose_file(tmp_path / "photos.csv")["a.jpg"]
    poses = [each.pose.model_dump() for each in (fixed, picture, listed) if each.pose is not None]
    lenses = [each.calibration.model_dump() for each in (fixed, picture, listed) if each.calibration is not None]
    assert poses == [poses[0]] * 3
    assert lenses == [lenses[0]] * 3
    assert picture.calibration.camera() == listed.calibration.camera_of(64, 40, 0.0) == CAMERA


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pose": POSE | {"position": [1, 2]}}, "pose.position: unknown key"),
        ({"calibration": CALIBRATION | {"hfov_deg": 50}}, "either hfov_deg or fx, not both"),
        ({"calibration": {"width": 64, "height": 40}}, "either hfov_deg or fx"),
        ({"calibration": {"fx": 40}}, "calibration.width: missing"),
        ({"pose": POSE | {"lon": -118, "lat": 34}}, "either x or lon"),
        ({"pose": {k: v for k, v in POSE.items() if k not in "xy"}}, "give x and y, or lon and lat"),
        ({"pose": {k: v for k, v in POSE.items() if k != "z"}}, "either z or height_above_ground"),
        ({"pose": POSE | {"azimuth_sigma_deg": 0}}, r"azimuth_sigma_deg: .*\(got 0, line \d+\)"),
        ({"azimuth_deg": 3.0}, "azimuth_deg: unknown key, line"),
    ],
)
def test_what_cannot_be_meant_is_named(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    (tmp_path / "pose.yaml").write_text(yaml.safe_dump({"pose": POSE, "calibration": CALIBRATION} | changes))
    with pytest.raises(ConfigError, match=message) as raised:
        load_yaml(tmp_path / "pose.yaml", PictureConfig)
    assert "pose.yaml:" in str(raised.value)


def dem_of(width: int = 40, height: int = 30) -> Dem:
    return Dem(np.full((height, width), 700.0, np.float32), GridGeometry(0.0, 300.0, 10.0, width, height))


def test_places_in_another_crs_and_directions_from_true_north() -> None:
    lon, lat = (float(v) for v in FRAME.to_lonlat(310.0, 120.0))
    for place in (
        {"lon": lon, "lat": lat},
        {"x": lon, "y": lat, "crs": "EPSG:4326"},
        {"x": 402_310.0, "y": 3_787_120.0},
    ):
        stated = PoseConfig(**place, height_above_ground=12.5, azimuth_deg=90.0, azimuth_ref="true")
        pose = stated.pose(dem_of(), FRAME)
        np.testing.assert_allclose(pose.position, [310.0, 120.0, 712.5], atol=1e-3)
        assert pose.angles_deg[0] == pytest.approx(FRAME.true_to_grid_deg(90.0, 310.0, 120.0))
    with pytest.raises(PoseError, match=r"no terrain under the camera at .* the DEM covers x 402000 to 402400"):
        PoseConfig(x=1.0, y=2.0, height_above_ground=3, azimuth_deg=4).pose(dem_of(), FRAME)
    with pytest.raises(ConfigError, match="EPSG:nine"):
        PoseConfig(x=1.0, y=2.0, crs="EPSG:nine", z=3, azimuth_deg=4).pose(dem_of(), FRAME)


def test_a_magnetic_azimuth_needs_its_day() -> None:
    stated = PoseConfig(**POSE | {"azimuth_ref": "magnetic"})
    with pytest.raises(ConfigError, match=r"214 is magnetic.*azimuth_ref: true"):
        stated.pose(dem_of(), FRAME)
    day = date(2024, 7, 5)
    azimuth = stated.grid_azimuth_deg(FRAME, (310.0, 120.0, 912.5), day)
    lon, lat = (float(v) for v in FRAME.to_lonlat(310.0, 120.0))
    true = 214.0 + magnetic_declination_deg(lon, lat, day, 912.5)
    assert azimuth == pytest.approx(FRAME.true_to_grid_deg(true, 310.0, 120.0))


def test_what_one_leaves_out_another_gives() -> None:
    fixed = PartialPose(
        x=1.0, y=2.0, position_sigma=0.5, z=3.0, azimuth_deg=90.0, azimuth_sigma_deg=0.2, pitch_deg=-4.0
    )
    row = PartialPose(height_above_ground=8.0, azimuth_deg=100.0, azimuth_ref="true", pitch_sigma_deg=1.0)
    both = row.over(fixed)
    assert (both.x, both.position_sigma, both.z, both.height_above_ground) == (1.0, 0.5, None, 8.0)
    assert (both.azimuth_deg, both.azimuth_ref, both.azimuth_sigma_deg) == (100.0, "true", None)
    assert (both.pitch_deg, both.pitch_sigma_deg, both.roll_deg) == (-4.0, 1.0, None)
    assert row.over(None) is row


def test_sigmas_become_a_covariance() -> None:
    stated = PoseConfig(**POSE, position_sigma=5.0, azimuth_sigma_deg=8.0)
    pose = stated.pose(dem_of(), FRAME)
    covariance = stated.covariance(pose, 0.5, 0.3)
    assert covariance is not None
    np.testing.assert_allclose(covariance, pose_covariance(pose, 5.0, 0.5, 8.0, 0.3, 0.3))
    assert PoseConfig(**POSE).covariance(pose, 0.5, 0.3) is None
