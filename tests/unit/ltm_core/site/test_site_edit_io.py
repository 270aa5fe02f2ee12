from pathlib import Path

import pytest
import yaml
from scenes.small_site import write_small_site

from ltm_core.base.errors import ConfigError
from ltm_core.site.site_io import edited, load_site, write_camera

SECTION = {"x": 1.5, "azimuth_deg": 12.0, "lens": {"width": 64, "zoom": [{"zoom": 1.0, "hfov_deg": 60.0}]}}
TEXT = """\
# A site.
name: ridge   # its name
cameras:
  # The first.
  north:
    image: compressed
    mount:
      azimuth_deg: 3.0   # by compass
      # of the second
      pan_sign: -1

    # after the mount
    calibration: {width: 640, height: 360, hfov_deg: 60}
  south: {}
  west:
    image: raw
# the end
workers: 2
"""


def test_a_section_is_replaced_and_all_else_stays() -> None:
    new = edited(TEXT, ("cameras", "north", "mount"), SECTION, "x")
    content = yaml.safe_load(new)
    assert content["cameras"]["north"]["mount"] == SECTION
    assert "zoom: 1.0, hfov_deg: 60.0}" in new  # a point of the table stands on one line
    content["cameras"]["north"]["mount"] = yaml.safe_load(TEXT)["cameras"]["north"]["mount"]
    assert content == yaml.safe_load(TEXT)
    for line in ("# A site.", "name: ridge   # its name", "  # The first.", "    # after the mount", "# the end"):
        assert f"{line}\n" in new
    assert "by compass" not in new


def test_a_section_is_put_into_a_camera_that_has_none() -> None:
    new = edited(TEXT, ("cameras", "west", "mount"), SECTION, "x")
    content = yaml.safe_load(new)
    assert content["cameras"]["west"] == {"mount": SECTION, "image": "raw"}
    assert content["workers"] == 2
    assert len(new.splitlines()) == len(TEXT.splitlines()) + 7


HEADER = "# Mine.\nname: ridge  # its name\n"


@pytest.mark.parametrize(
    ("before", "kept"),
    [
        (TEXT, {"north", "south", "west"}),
        (HEADER, set()),
        (HEADER + "cameras:   # none yet\n# the end\n", set()),
        (HEADER + "cameras: {}   # none yet\n", set()),
        (HEADER + "cameras: {north: {image: raw}, south: {}}\nworkers: 2\n", {"north", "south"}),
        (HEADER + "cameras:\n    east: {image: raw}   # to come\n    west:\n", {"west"}),
        (HEADER + "cameras:\n  east:\n", set()),
    ],
)
def test_a_camera_is_added_or_completed_in_every_form_of_the_file(before: str, kept: set[str]) -> None:
    after = edited(before, ("cameras", "east", "source"), {"kind": "snapshot"}, "x")
    old, new = yaml.safe_load(before), yaml.safe_load(after)
    cameras = old.pop("cameras", None) or {}
    expected = {**cameras, "east": {**(cameras.get("east") or {}), "source": {"kind": "snapshot"}}}
    assert new.pop("cameras") == expected
    assert set(expected) == kept | {"east"}
    assert new == old
    comments = [line[line.index("#") :] for line in before.splitlines() if "#" in line]
    assert [comment for comment in comments if comment not in after] == []


@pytest.mark.parametrize(
    "text", ["cameras: [1]\n", "cameras: north\n", "", "a", "cameras: {\n  north: {},  # mine\n  west: {}}\n"]
)
def test_a_file_that_cannot_take_a_camera_is_rejected(text: str) -> None:
    with pytest.raises(ConfigError, match=r"site\.yaml"):
        edited(text, ("cameras", "east", "source"), {"kind": "snapshot"}, "site.yaml")


def test_what_makes_no_site_leaves_the_file_as_it_is(tmp_path: Path) -> None:
    path = write_small_site(tmp_path, recording=False).path
    before = path.read_text()
    with pytest.raises(ConfigError, match=r"was not changed[\s\S]*yaw_deg: unknown key"):
        write_camera(path, "mast", {"mount": {"x": 1.0, "yaw_deg": 3.0}})
    assert path.read_text() == before
    assert {p.name for p in tmp_path.glob(".*")} == set()
    calibration = {"width": 640, "height": 360, "hfov_deg": 50.0}
    write_camera(path, "mast", {"calibration": calibration})
    assert load_site(path).camera("mast").calibration is not None
    assert yaml.safe_load(path.read_text())["cameras"]["mast"]["calibration"] == calibration
    with pytest.raises(ConfigError, match="mast already has calibration"):
        write_camera(path, "mast", {"calibration": {**calibration, "width": 64}}, replace=False)
    assert yaml.safe_load(path.read_text())["cameras"]["mast"]["calibration"] == calibration
    write_camera(path, "mast", {"calibration": {**calibration, "width": 64}})
    assert yaml.safe_load(path.read_text())["cameras"]["mast"]["calibration"]["width"] == 64


LISTED = """\
dem:   # two rasters
- path: a.tif  # lidar
  crs: EPSG:1
# far
- path: b.tif
cameras: {}
"""


@pytest.mark.parametrize(
    ("text", "item", "expected"),
    [
        (LISTED, 0, LISTED.replace("a.tif  # lidar\n  crs: EPSG:1", "c.tif  # new")),
        (LISTED, 1, LISTED.replace("b.tif", "c.tif  # new")),
        (LISTED, 2, LISTED.replace("cameras", "- path: c.tif  # new\ncameras")),
        ("dem:\n  -\n    path: a\n  - path: b", 0, "dem:\n  - path: c.tif  # new\n  - path: b\n"),
        ("dem:\n  - path: a\n    crs: [x,\n  -1]\n  - b", 0, "dem:\n  - path: c.tif  # new\n  - b\n"),
        ("dem: [a, b]  # both\nx: 1\n", 1, "dem:   # both\n- a\n- path: c.tif  # new\nx: 1\n"),
    ],
)
def test_an_item_of_a_list_is_replaced_or_added_with_a_comment(text: str, item: int, expected: str) -> None:
    assert edited(text, ("dem", item), {"path": "c.tif"}, "x", "new") == expected


@pytest.mark.parametrize(
    ("keys", "value", "expected"),
    [
        (("dem", 1), "c.tif", LISTED.replace("path: b.tif", "c.tif")),
        (("dem", 0, "path"), "c.tif", LISTED.replace("a.tif  # lidar", "c.tif")),
    ],
)
def test_an_item_keeps_its_dash(keys: tuple[str | int, ...], value: object, expected: str) -> None:
    assert edited(LISTED, keys, value, "x") == expected
