from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scenes.small_site import TOWER, write_small_site

from ltm_core.base.errors import ConfigError, SiteVerdict
from ltm_core.site.networks import site_scene_filter
from ltm_core.site.site_check import check_site
from ltm_core.site.site_io import load_site
from ltm_core.vision.mask_config import MaskPolygon, ViewMask
from ltm_core.vision.masks import Looking, write_mask

WIDE = TOWER.hfov_deg
POLYGON = MaskPolygon(polygon=((0, 0), (9, 0), (9, 4)))


def rectangle(top: int, left: int, bottom: int, right: int) -> dict[str, Any]:
    return {"polygon": [[left, top], [right - 1, top], [right - 1, bottom - 1], [left, bottom - 1]]}


def view(name: str, azimuth_deg: float, mask: object, **more: object) -> dict[str, Any]:
    return {"name": name, "azimuth_deg": azimuth_deg, "pitch_deg": -14.0, "mask": mask, **more}


def site_with(folder: Path, views: list[dict[str, Any]], camera: str = "tower", **more: object) -> Path:
    path = write_small_site(folder, recording=False).path
    content = yaml.safe_load(path.read_text())
    content["cameras"][camera] |= {"view_masks": views, **more}
    path.write_text(yaml.safe_dump(content))
    return path


def test_the_angle_between_a_picture_and_a_view() -> None:
    east = ViewMask(name="east", azimuth_deg=359.8, pitch_deg=60.0, hfov_deg=40.0, mask=(POLYGON,))
    assert Looking(359.8, 60.0, 40.0).off_deg(east) == 0.0
    # Across north, and half as far at 60 degrees of pitch as on the horizon (for small angles).
    assert Looking(0.2, 60.0, 40.0).off_deg(east) == pytest.approx(0.2, rel=1e-4)
    assert Looking(359.8, 59.0, 41.0).off_deg(east) == pytest.approx(1.0)
    assert Looking(359.8, 60.0, 41.5).off_deg(east) == np.inf
    assert Looking(359.8, 60.0, 38.5).off_deg(east) == np.inf


def test_each_view_has_its_mask_and_that_of_all_views(tmp_path: Path) -> None:
    hidden = np.zeros((TOWER.height, TOWER.width), np.bool_)
    hidden[30:90, 200:] = True
    write_mask(tmp_path / "north.png", hidden)
    views = [view("north", 0.0, "north.png"), view("east", 90.0, [rectangle(100, 5, 150, 60)], within_deg=2.0)]
    scene = site_scene_filter(load_site(site_with(tmp_path, views, mask=[rectangle(0, 0, 8, 320)])), "tower")
    caption, roof = np.zeros_like(hidden), np.zeros_like(hidden)
    caption[:8] = True
    roof[100:150, 5:60] = True
    for azimuth, expected in (
        (0.3, hidden | caption),
        (359.6, hidden | caption),
        (0.6, caption),
        (88.2, roof | caption),
        (180.0, caption),
        (359.6, hidden | caption),
        (None, caption),
    ):
        looking = None if azimuth is None else Looking(azimuth, -14.0, WIDE)
        found = scene.hidden(TOWER.width, TOWER.height, looking)
        assert found is not None
        np.testing.assert_array_equal(found, expected, str(azimuth))


def test_a_view_that_has_none_and_another_zoom_hide_nothing(tmp_path: Path) -> None:
    views = [view("north", 0.0, [rectangle(9, 5, 50, 60)], hfov_deg=30.0)]
    scene = site_scene_filter(load_site(site_with(tmp_path, views)), "tower")
    picture = np.random.default_rng(2).integers(0, 255, (180, 320, 3), np.uint8)
    for looking in (Looking(0.0, -14.0, 62.0), Looking(0.0, 10.0, 30.0)):
        found = scene.look(picture, looking)
        assert found.hidden is None
        assert found.masked.startswith("no view of the site file has this direction: azimuth 0.0")
    found = scene.look(picture, Looking(0.0, -14.0, 30.5))
    assert found.masked == "view north"
    assert found.hidden is not None
    assert found.hidden.sum() == 41 * 55


def test_of_two_views_the_nearer_is_taken(tmp_path: Path) -> None:
    views = [view("a", 10.0, [rectangle(0, 0, 3, 4)], within_deg=3.0), view("b", 12.0, [rectangle(0, 0, 5, 6)])]
    views[1]["within_deg"] = 3.0
    path = site_with(tmp_path, views)
    scene = site_scene_filter(load_site(path), "tower")
    for azimuth, count in ((10.9, 12), (11.1, 30)):
        found = scene.hidden(320, 180, Looking(azimuth, -14.0, WIDE))
        assert found is not None
        assert found.sum() == count
    (said, _) = (f for f in check_site(path).findings if "mask of view" in f.name)
    assert said.verdict is SiteVerdict.DOUBTFUL
    assert "b has that direction too" in said.said


def test_what_cannot_be_is_told_in_words(tmp_path: Path) -> None:
    good = [rectangle(9, 5, 50, 60)]
    twice = [view("a", 10.0, good), view("a", 40.0, good)]
    for number, (camera, views, said) in enumerate(
        (
            ("tower", twice, "a is repeated"),
            ("mast", [view("a", 10.0, good)], "view_masks are for a camera that turns"),
            ("tower", [view("a", 400.0, good)], "azimuth is 0 to 360"),
            ("tower", [view("a", 10.0, good, within=1)], "within"),
            ("tower", [view("a", 10.0, "../m.png")], r"view_masks\.a: .*is outside the site's folder"),
        )
    ):
        (tmp_path / str(number)).mkdir()
        with pytest.raises(ConfigError, match=said):
            load_site(site_with(tmp_path / str(number), views, camera))
