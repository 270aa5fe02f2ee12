from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ltm_core.base.errors import ConfigError
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site

REPOSITORY = Path(__file__).parents[4]
SITE: dict[str, Any] = {
    "name": "ridge",
    "crs": "EPSG:32611",
    "origin": [346_000.0, 3_783_000.0],
    "dem": {"path": "dem.tif"},
    "cameras": {"north": {}},
}


def load(folder: Path, **changes: Any) -> Site:
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(SITE | changes), encoding="utf-8")
    return load_site(path)


def test_paths_are_relative_to_the_site_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner/own.yaml").touch()
    site = load(tmp_path / "inner", dem={"path": "../maps/dem.tif"}, model="own.yaml")
    assert site.dem.path.resolve() == (tmp_path / "maps/dem.tif").resolve()
    assert site.model == str(tmp_path / "inner/own.yaml")
    assert load(tmp_path, dem={"path": "/abs/dem.tif"}).dem.path == Path("/abs/dem.tif")
    assert load(tmp_path).model == "landscape_v5"
    monkeypatch.chdir(tmp_path)
    assert load_site("site.yaml").dem.path == tmp_path / "dem.tif"


@pytest.mark.parametrize(
    ("changes", "messages"),
    [
        ({"curvatur": True}, ["curvatur: unknown key", "curvature"]),
        ({"fuel": {"cell": 30}}, ["fuel.cell: unknown key"]),
        ({"name": "Ridge"}, ["name", "'Ridge'", "a-z, 0-9 and _"]),
        ({"name": "ridge/west"}, ["'ridge/west'"]),
        ({"name": "9ridge"}, ["'9ridge'"]),
        ({"name": ""}, ["''"]),
        ({"cameras": {"north east": {}}}, ["cameras.north east", "topic names"]),
        ({"cameras": {"fuel_map": {}}}, ["'fuel_map' is the name of a node"]),
        ({"cameras": {}}, ["cameras", "ltm cameras probe"]),
        ({"alerts": {"token": {"environment": "HOOK"}}}, ["alerts", "webhook"]),
        ({"alerts": {"webhook": "http://u:p@host/"}}, ["alerts.webhook", "password"]),
        ({"alerts": {"webhook": "ftp://host/"}}, ["alerts.webhook", "http"]),
        ({"alerts": {"webhook": "http://host/{token}"}}, ["alerts", "token: {credential"]),
        ({"alerts": {"mqtt": "mqtts://b"}, "expert": {"alerts": {"key": "k.pem"}}}, ["alerts", "certificate and key"]),
        ({"alerts": {"mqtt": "mqtts://b", "password": {"file": "p"}}}, ["alerts", "user"]),
        ({"alerts": {"mqtt": "mqtts://u:p@b"}}, ["alerts.mqtt", "password"]),
        ({"alerts": {"mqtt": "mqtt://10.0.0.1"}}, ["alerts", "mqtts://10.0.0.1"]),
        ({"alerts": {"mqtt": "mqtt://127.broker.example"}}, ["alerts", "mqtts://127.broker.example"]),
        ({"crs": "EPSG:4326"}, ["crs", "projected in metres"]),
        ({"crs": "somewhere"}, ["crs", "'somewhere'", "EPSG:32611"]),
        ({"origin": [1.0]}, ["origin.1: missing"]),
        ({"cameras": {"a": {"pose": {"x": 0, "y": 0, "z": 1, "azimuth_deg": 9, "pitch_deg": -95}}}}, ["-95", "-90"]),
        ({"cameras": {"a": {"pose": {"x": 0, "y": 0, "z": 1, "azimuth_deg": 9, "roll_deg": 200}}}}, ["200", "180"]),
        ({"expert": {"refraction": 1.0}}, ["refraction", "got 1.0"]),
        ({"cameras": {"a": {"image": "mjpeg"}}}, ["cameras.a.image", "got 'mjpeg'"]),
        ({"cameras": {"a": {"calibration": {"width": 0, "height": 6, "fx": 5}}}}, ["width", "got 0"]),
    ],
)
def test_wrong_site_files(tmp_path: Path, changes: dict[str, Any], messages: list[str]) -> None:
    with pytest.raises(ConfigError) as raised:
        load(tmp_path, **changes)
    for message in ["site.yaml", *messages]:
        assert message in str(raised.value)


def test_alerts_run_the_health_node_and_name_files_beside_the_site_file(tmp_path: Path) -> None:
    broker = {"mqtt": "mqtts://10.8.0.1", "user": "ridge", "password": {"file": "mqtt"}}
    alerts = {"webhook": "https://host/{token}", "token": {"file": "hook"}, **broker}
    site = load(tmp_path, alerts=alerts, expert={"alerts": {"ca": "ca.crt"}})
    assert site.health is not None
    assert site.health.address == "127.0.0.1"
    assert site.alerts is not None
    assert site.alerts.token is not None
    assert site.alerts.password is not None
    assert (site.alerts.token.file, site.alerts.password.file) == (tmp_path / "hook", tmp_path / "mqtt")
    assert site.alerts.ca == tmp_path / "ca.crt"
    assert load(tmp_path, alerts={"mqtt": "mqtt://[::1]:1883"}, health={"port": 9000}).health.port == 9000  # type: ignore[union-attr]
    assert load(tmp_path).health is None


def test_an_origin_far_from_the_dem(tmp_path: Path) -> None:
    geometry = GridGeometry(346_500.0, 3_784_000.0, 10.0, 9, 7, "EPSG:32611")
    Dem(np.zeros((7, 9), np.float32), geometry).save(tmp_path / "dem.tif")
    assert load(tmp_path).open_dem().geometry.x_min == 500.0
    with pytest.raises(
        ConfigError, match=r"origin \[3783000, 346000\] is 4\d+ km from the DEM.* swapped, write \[346000, 3783000\]"
    ):
        load(tmp_path, origin=[3_783_000.0, 346_000.0]).open_dem()
    with pytest.raises(ConfigError, match=r"origin \[0, 0\] .* near the site, such as \[347000, 3784000\]"):
        load(tmp_path, origin=[0.0, 0.0]).open_dem()


def test_the_fuel_grid_is_snapped_in_the_crs(tmp_path: Path) -> None:
    site = load(tmp_path, origin=[346_007.0, 3_783_004.0])
    dem = Dem(np.zeros((7, 9), np.float32), GridGeometry(-20.0, 50.0, 10.0, 9, 7))
    grid = site.fuel_geometry(dem)
    in_crs = site.in_crs(grid)
    # The DEM spans 345987..346077 by 3782984..3783054; edges are 15 mod 30, and 345975 = 15 + 30 * 11532.
    assert in_crs.bounds == (345_975.0, 3_782_955.0, 346_095.0, 3_783_075.0)
    assert in_crs.crs == "EPSG:32611"
    assert grid.bounds == (345_975.0 - 346_007, 3_782_955.0 - 3_783_004, 346_095.0 - 346_007, 3_783_075.0 - 3_783_004)
    assert grid.crs is None


@pytest.mark.parametrize(
    "path", [*sorted((REPOSITORY / "config/sites").glob("*.yaml")), REPOSITORY / "bags/demo/site.yaml"], ids=str
)
def test_committed_site_files(path: Path) -> None:
    site = load_site(path)
    assert site.frame.crs == site.crs


def test_pictures_of_videos_may_be_published_as_they_are_decoded(tmp_path: Path) -> None:
    """A stream is decoded; of a snapshot there is only the camera's JPEG."""
    stream = {"kind": "rtsp", "url": "rtsp://127.0.0.1/live"}
    snapshot = {"kind": "snapshot", "url": "http://127.0.0.1/a.jpg", "every": 5}
    known = {"image": "raw", "calibration": {"width": 640, "height": 480, "hfov_deg": 50}}
    assert load(tmp_path, cameras={"north": known | {"source": stream}}).camera("north").image == "raw"
    with pytest.raises(ConfigError, match="publishes the camera's JPEGs"):
        load(tmp_path, cameras={"north": known | {"source": snapshot}})
