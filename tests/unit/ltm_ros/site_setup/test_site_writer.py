from pathlib import Path

import pytest
import yaml

from ltm_core.site.site_io import load_site
from ltm_ros.site_setup.layers import Layer
from ltm_ros.site_setup.site_writer import change_site, changed, site_text
from ltm_ros.site_setup.vertical import NAVD88

CAMERA = {
    "calibration": {"width": 640, "height": 360, "hfov_deg": 54.0},
    "pose": {"lon": -118.5, "lat": 34.1, "height_above_ground": 20.0, "azimuth_deg": 214.0, "azimuth_ref": "true"},
}
OWN = """\
# my site
name: ridge   # the old name
crs: EPSG:32611
origin: [346000, 3783000]
dem: {path: mine.tif}  # lidar of 2019
model: "landscape_v5"

# cameras of the county
cameras:
  west: {}   # not mounted yet
  east:
    pose: {x: 1.0, y: 2.0, z: 900, azimuth_deg: 10}   # surveyed
"""


def layer(name: str, described: str = "30 m, somewhere, 2024") -> Layer:
    return Layer(Path(name), described)


def test_a_new_site_file_is_a_site_with_its_provenance(tmp_path: Path) -> None:
    layers = {"dem": layer("dem.tif"), "coarser": layer("dem_coarse.tif"), "fuel": layer("fuel")}
    text = site_text("getty", "EPSG:32611", (364000.0, 3774000.0), NAVD88, layers, {"north": CAMERA})
    (tmp_path / "site.yaml").write_text(text)
    site = load_site(tmp_path / "site.yaml")
    assert (site.name, site.crs, site.origin) == ("getty", "EPSG:32611", (364000, 3774000))
    assert [dem.path.name for dem in (site.dem, *site.coarser)] == ["dem.tif", "dem_coarse.tif"]
    assert site.fuel.prior is not None
    assert site.fuel.prior.path == tmp_path / "fuel"
    assert site.cameras["north"].pose is not None
    assert site.cameras["north"].pose.azimuth_ref == "true"
    assert text.count("# 30 m, somewhere, 2024") == 3
    assert "EPSG:5703" in text


@pytest.mark.parametrize("key", ["dem", "coarser", "surface", "fuel"])
def test_a_change_keeps_all_other_keys_and_comments(key: str, tmp_path: Path) -> None:
    path = tmp_path / "site.yaml"
    path.write_text(OWN)
    change_site(path, {key: layer("new", "1 m, survey, 2025")}, {"north": CAMERA})
    text = path.read_text()
    for comment in ("# my site", "# the old name", "# cameras of the county", "# not mounted yet", "# surveyed"):
        assert comment in text
    assert '"landscape_v5"' in text
    assert "2025" in text
    before, after = yaml.safe_load(OWN), yaml.safe_load(text)
    assert after["cameras"] == {**before["cameras"], "north": CAMERA}
    assert {k: v for k, v in after.items() if k not in ("cameras", "dem", key)} == {
        k: v for k, v in before.items() if k not in ("cameras", "dem", key)
    }
    site = load_site(path)
    names = [dem.path.name for dem in (site.dem, *site.coarser)]
    assert names == {"dem": ["new"], "coarser": ["mine.tif", "new"]}.get(key, ["mine.tif"])
    if key == "surface":
        assert site.surface is not None
        assert site.surface.path.name == "new"
    if key == "fuel":
        assert site.fuel.prior is not None
        assert site.fuel.prior.path == tmp_path / "new"


@pytest.mark.parametrize(
    ("prior", "expected"),
    [
        ("landfire/", "new/"),
        ("{fbfm40: f.tif, cover: c.tif, unknown_codes: built}", {"path": "new/", "unknown_codes": "built"}),
    ],
)
def test_a_newer_fuel_map_keeps_the_rules_for_codes(prior: str, expected: object) -> None:
    text = changed(OWN + f"fuel: {{prior: {prior}, climate: humid}}\n", {"fuel": layer("new")}, {}, "site.yaml")
    assert yaml.safe_load(text)["fuel"] == {"prior": expected, "climate": "humid"}
