"""Cameras of options and lists."""

import json
from pathlib import Path

import pytest
from PIL import Image

from ltm_core.base.errors import ConfigError
from ltm_core.site.sections import CameraConfig
from ltm_ros.site_setup.camera_list import parse_camera, read_cameras, section
from ltm_ros.site_setup.vertical import EGM2008, ELLIPSOIDAL, NAVD88, MissingGridError


def test_an_option_becomes_a_pose_and_a_calibration() -> None:
    camera = parse_camera("North 1=-118.48,34.1,height=20,azimuth=214,pitch=-3,hfov=54,size=3072x1728")
    entry, remarks = section(camera, None)
    assert camera.ros_name == "north_1"
    assert entry == {
        "calibration": {"width": 3072, "height": 1728, "hfov_deg": 54.0},
        "pose": {
            "lon": -118.48, "lat": 34.1, "height_above_ground": 20.0, "azimuth_deg": 214.0, "azimuth_ref": "true",
            "pitch_deg": -3.0,
        },
    }  # fmt: skip
    assert remarks == []
    CameraConfig.model_validate(entry)


def test_photos_give_the_size_of_the_images(tmp_path: Path) -> None:
    Image.new("RGB", (640, 360)).save(tmp_path / "a.jpg")
    entry, _ = section(parse_camera(f"a=1,2,azimuth=0,hfov=50,photos={tmp_path}"), None)
    config = CameraConfig.model_validate(entry)
    assert config.calibration is not None
    assert (config.calibration.width, config.calibration.height) == (640, 360)
    assert config.source is not None
    assert (config.source.kind, config.source.path) == ("folder", tmp_path)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    "text",
    [
        "north",
        "=1,2",
        "north=1",
        "north=1,2,height",
        "north=1,2,azimuth=1,azimuth=2",
        "north=1,95",
        "north=200,2",
        "north=1,2,hfov=190",
        "north=1,2,colour=red",
        "north=1,2,datum=egm96",
        "north=1,2,size=big",
        "north=1,2,photos=/nowhere/at/all",
    ],
)
def test_an_option_that_cannot_be_is_an_error(text: str) -> None:
    with pytest.raises(ConfigError):
        parse_camera(text)


def test_heights_of_cameras_have_their_own_datum() -> None:
    camera = parse_camera("a=-118,34,z=500,azimuth=0,hfov=50")
    assert section(camera, NAVD88)[0]["pose"]["z"] == 500
    same = parse_camera("a=-118,34,z=500,datum=navd88,azimuth=0,hfov=50")
    assert section(same, NAVD88)[0]["pose"]["z"] == 500
    over = parse_camera("a=-118,34,z=500,datum=EPSG:6319,azimuth=0,hfov=50")  # NAD83 lies lower than WGS 84 there
    assert section(over, ELLIPSOIDAL)[0]["pose"]["z"] == pytest.approx(499.3, abs=0.1)
    with pytest.raises(ConfigError):
        section(same, None)
    with pytest.raises(MissingGridError):
        section(parse_camera("a=-150,61,z=500,datum=EPSG:25833+5941,azimuth=0,hfov=50"), EGM2008)


@pytest.mark.parametrize(
    "text",
    [
        "name,lon,lat,azimuth,hfov\nnorth,-118.5,34.1,214,54\n",
        "Camera;Longitude;Latitude;Bearing;FOV;county\nnorth;-118.5;34.1;214;54;LA\n",
        "\ufeffid\tx\ty\tAZ\tfov_deg\nnorth\t-118.5\t34.1\t214\t54\n\n",
    ],
)
def test_tables_may_name_their_columns_in_several_ways(text: str, tmp_path: Path) -> None:
    (tmp_path / "c.csv").write_text(text, encoding="utf-8")
    (camera,), _ = read_cameras(tmp_path / "c.csv")
    assert (camera.name, camera.lon, camera.lat, camera.azimuth, camera.hfov) == ("north", -118.5, 34.1, 214, 54)


def test_geojson_has_points_with_properties(tmp_path: Path) -> None:
    feature = {
        "type": "Feature",
        "geometry": {"type": "Point", "coordinates": [-118.5, 34.1, 700]},
        "properties": {"name": "north", "azimuth_deg": 214, "hfov": 54, "height": 12, "z": None},
    }
    (tmp_path / "c.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    (camera,), _ = read_cameras(tmp_path / "c.geojson")
    assert (camera.azimuth, camera.height, camera.z) == (214, 12, None)


def test_the_list_of_alertcalifornia_gives_turning_cameras(tmp_path: Path) -> None:
    def feature(name: str, point: list[float | None]) -> dict[str, object]:
        about = {
            "id": f"Axis-{name}", "name": f"{name} 1", "last_frame_ts": 1764000000, "az_current": 133.2,
            "tilt_current": -1.5, "zoom_current": 1, "fov": 61.4, "county": "la",
        }  # fmt: skip
        return {"type": "Feature", "geometry": {"type": "Point", "coordinates": point}, "properties": about}

    features = [feature("Mulholland", [-118.43, 34.13, 400]), feature("Hidden", [None, None])]
    (tmp_path / "all.json").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    (camera,), remarks = read_cameras(tmp_path / "all.json")
    entry, doubts = section(camera, None)
    config = CameraConfig.model_validate(entry)
    assert camera.ros_name == "mulholland_1"
    assert config.mount is not None
    assert config.source is not None
    assert (config.source.kind, config.source.id) == ("camera_list", "Axis-Mulholland")  # type: ignore[union-attr]
    assert len(remarks) == 1  # the one without a position
    assert len(doubts) == 1  # a position of two decimals


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("c.csv", "name,northing,easting\na,1,2\n"),
        ("c.csv", ""),
        ("c.csv", "name,lon,lat\na,east,2\n"),
        ("c.csv", "name,lon,lat\n"),
        ("c.json", '{"cameras": 3}'),
        ("c.json", '{"features": [3]}'),
        ("c.json", "[["),
        ("c.json", '{"features": []}'),
        ("c.json", "[" * 100_000),
    ],
)
def test_a_file_that_is_no_list_is_an_error_that_names_it(name: str, text: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=name.replace(".", r"\.")):
        read_cameras(tmp_path / name)
