import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
import yaml
from scenes.located import CAMERA, hills, sighting

from ltm_core.base.errors import ConfigError, LtmError, RegionError
from ltm_core.raster.dem import Dem
from ltm_ros.cli.locate import FILES, locate

pytestmark = pytest.mark.kernel

FIRE = np.array([-100.0, 2480.0, 64.0])
TOWERS = {"north": (-900.0, 1300.0, 180.0), "east": (1200.0, 1700.0, 190.0), "south": (200.0, 1250.0, 160.0)}


def site(folder: Path, turned: str = "") -> Path:
    """`turned`: the camera whose stated azimuth is 2 degrees too great."""
    dem = hills()
    moved = replace(dem.geometry, x_min=dem.geometry.x_min + 4e5, y_max=dem.geometry.y_max + 38e5, crs="EPSG:32611")
    Dem(dem.elevation, moved).save(folder / "dem.tif")
    cameras: dict[str, Any] = {"far": {}}
    for name, (x, y, z) in TOWERS.items():
        seen = sighting(name, (x, y, z), FIRE, turned_deg=2.0 if name == turned else 0.0)
        azimuth, pitch, roll = seen.pose.angles_deg
        angles = {"azimuth_deg": azimuth, "pitch_deg": pitch, "roll_deg": roll, "azimuth_sigma_deg": 0.05}
        cameras[name] = {
            "calibration": {"width": CAMERA.width, "height": CAMERA.height, "fx": CAMERA.fx},
            "pose": {"x": x + 4e5, "y": y + 38e5, "z": z, "pitch_sigma_deg": 0.05, "roll_sigma_deg": 0.05} | angles,
            "mask": [{"class": "caption", "polygon": [[0, 0], [80, 0], [80, 30], [0, 30]]}],
        }
    content = {"name": "hollow", "crs": "EPSG:32611", "origin": [4e5, 38e5], "dem": {"path": "dem.tif"}}
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(content | {"expert": {"curvature": False}, "cameras": cameras}))
    return path


def marked(camera: str) -> str:
    u, v = sighting(camera, TOWERS[camera], FIRE).mark.pixels[0]
    return f"{u},{v}"


def test_two_cameras_say_where_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    marks = [f"{name}={marked(name)}" for name in ("north", "east")]
    locate(site=site(tmp_path), mark=marks, smoke=True, out=out, as_json=True)
    said = json.loads(capsys.readouterr().out)
    assert (said["place"]["x"], said["place"]["y"]) == pytest.approx((399_900, 3_802_480), abs=15)
    assert said["place"]["mgrs"].startswith("11S")
    assert said["agreement"]["agree"]
    views = {view["camera"]: view for view in said["cameras"]}
    assert set(views) == set(TOWERS)
    assert views["south"]["pixel"] == pytest.approx([float(v) for v in marked("south").split(",")], abs=15)
    assert {path.name for path in out.iterdir()} == set(FILES)
    assert json.loads((out / "locate.json").read_text()) == said
    assert json.loads((out / "locate.geojson").read_text())["type"] == "FeatureCollection"
    with rasterio.open(out / "posterior.tif") as raster:
        assert raster.crs.to_epsg() == 32611
        values = raster.read(1)
        row, col = np.unravel_index(values.argmax(), values.shape)
        assert raster.xy(row, col) == pytest.approx((399_900, 3_802_480), abs=20)
        assert values.sum() == pytest.approx(1, abs=1e-3)
    picture = cv2.imread(str(out / "locate.png"))
    assert picture is not None
    assert picture.shape[1] > 1000


def test_a_place_is_found_in_the_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = site(tmp_path)
    locate(site=path, place="399900,3802480", as_json=True)
    (said,) = json.loads(capsys.readouterr().out)
    views = {view["camera"]: view for view in said["cameras"]}
    for camera in TOWERS:
        assert views[camera]["pixel"] == pytest.approx([float(v) for v in marked(camera).split(",")], abs=0.5)
    cv2.imwrite(str(tmp_path / "photo.png"), np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8))
    out = tmp_path / "out"
    locate(site=path, place="399900,3802480", photo=f"north={tmp_path}/photo.png", out=out)
    drawn = cv2.imread(str(out / "places.png"))
    u, v = (round(float(x)) for x in marked("north").split(","))
    assert (drawn[v - 30 : v + 30, u - 30 : u + 30] != 90).any()
    assert (drawn[:200, :200] == 90).all()
    assert "north" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"mark": ["west=1,2"]}, ConfigError, "no camera 'west'; there are"),
        ({"mark": ["far=1,2"]}, ConfigError, "--pose far=FILE"),
        ({"mark": ["1,2"]}, ConfigError, "--mark NAME=1,2"),
        ({"mark": ["north=1,b"]}, ConfigError, "numbers separated by commas"),
        ({"mark": ["north=1,2,3"]}, ConfigError, "a mark is u,v"),
        ({"mark": ["north=5000,2"]}, RegionError, "outside the image"),
        ({"mark": ["north=960,5"]}, RegionError, "shows sky"),
        ({"mark": ["north=60,20"]}, RegionError, "is masked"),
        ({}, ConfigError, "give --mark"),
        ({"mark": ["1,2"], "place": "1,2"}, ConfigError, "give --mark"),
        ({"place": "1"}, ConfigError, "needs 2 or 3"),
        ({"place": "1,2"}, RegionError, "the DEM covers"),
    ],
)
def test_what_cannot_be_is_told(tmp_path: Path, options: dict[str, Any], error: type[LtmError], said: str) -> None:
    with pytest.raises(error, match=said):
        locate(site=site(tmp_path), **options)
