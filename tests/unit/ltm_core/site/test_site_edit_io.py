"""A section of a camera is changed in a site file; every other line stays."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from scenes.small_site import write_small_site

from ltm_core.base.errors import ConfigError
from ltm_core.site.site_io import edited, load_site, write_camera_section

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
    new = edited(TEXT, "north", "mount", SECTION, "x")
    content = yaml.safe_load(new)
    assert content["cameras"]["north"]["mount"] == SECTION
    assert "zoom: 1.0, hfov_deg: 60.0}" in new  # a point of the table stands on one line
    content["cameras"]["north"]["mount"] = yaml.safe_load(TEXT)["cameras"]["north"]["mount"]
    assert content == yaml.safe_load(TEXT)
    for line in ("# A site.", "name: ridge   # its name", "  # The first.", "    # after the mount", "# the end"):
        assert f"{line}\n" in new
    assert "by compass" not in new


def test_a_section_is_put_into_a_camera_that_has_none() -> None:
    new = edited(TEXT, "west", "mount", SECTION, "x")
    content = yaml.safe_load(new)
    assert content["cameras"]["west"] == {"mount": SECTION, "image": "raw"}
    assert content["workers"] == 2
    assert len(new.splitlines()) == len(TEXT.splitlines()) + 7


def test_a_camera_that_is_not_there_is_added_behind_the_others() -> None:
    new = edited(TEXT, "east", "source", {"kind": "snapshot"}, "x")
    content = yaml.safe_load(new)
    assert list(content["cameras"]) == ["north", "south", "west", "east"]
    assert content["cameras"]["east"] == {"source": {"kind": "snapshot"}}
    assert new.index("east:") < new.index("# the end")


@pytest.mark.parametrize("text", ["name: x\n", "cameras: {north: {}}\n", "cameras: [1]\n", ""])
def test_a_file_without_cameras_in_lines_is_told(text: str) -> None:
    with pytest.raises(ConfigError, match="section `cameras:`"):
        edited(text, "north", "mount", SECTION, "site.yaml")


def test_a_camera_within_braces_is_told() -> None:
    with pytest.raises(ConfigError, match="south is written in braces"):
        edited(TEXT, "south", "mount", SECTION, "site.yaml")


def test_what_makes_no_site_leaves_the_file_as_it_is(tmp_path: Path) -> None:
    path = write_small_site(tmp_path, recording=False).path
    before = path.read_text()
    with pytest.raises(ConfigError, match=r"was not changed[\s\S]*yaw_deg: unknown key"):
        write_camera_section(path, "mast", "mount", {"x": 1.0, "yaw_deg": 3.0})
    assert path.read_text() == before
    assert {p.name for p in tmp_path.glob(".*")} == set()
    calibration = {"width": 640, "height": 360, "hfov_deg": 50.0}
    write_camera_section(path, "mast", "calibration", calibration)
    assert load_site(path).camera("mast").calibration is not None
    assert yaml.safe_load(path.read_text())["cameras"]["mast"]["calibration"] == calibration
