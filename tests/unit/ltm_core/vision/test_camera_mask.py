from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image
from scenes.small_site import MAST, write_small_site

from ltm_core.base.errors import ConfigError, SiteVerdict
from ltm_core.site.networks import site_scene_filter
from ltm_core.site.site_check import check_site
from ltm_core.site.site_io import load_site
from ltm_core.vision.masks import MaskMaker, write_mask


def corner(height: int = MAST.height, width: int = MAST.width) -> np.ndarray:
    hidden = np.zeros((height, width), np.bool_)
    hidden[:40, -70:] = True
    return hidden


def site_with(folder: Path, mask: object, camera: str = "mast") -> Path:
    path = write_small_site(folder, recording=False).path
    content = yaml.safe_load(path.read_text())
    content["cameras"][camera]["mask"] = mask
    path.write_text(yaml.safe_dump(content))
    return path


def test_a_mask_comes_back_as_it_was_written(tmp_path: Path) -> None:
    hidden = corner()
    write_mask(tmp_path / "m.png", hidden)
    np.testing.assert_array_equal(MaskMaker(tmp_path / "m.png", "here")(*hidden.shape[::-1]), hidden)
    scene = site_scene_filter(load_site(site_with(tmp_path, "m.png")), "mast")
    blocks = np.random.default_rng(3).integers(20, 235, (MAST.height // 8, MAST.width // 8, 3), np.uint8)
    view = scene.look(blocks.repeat(8, 0).repeat(8, 1))
    assert view.reason is None
    assert view.hidden is not None
    np.testing.assert_array_equal(view.hidden, hidden)
    labels, confidence = np.full(hidden.shape, 3, np.uint8), np.full(hidden.shape, 200, np.uint8)
    view.unlabelled(labels, confidence)
    np.testing.assert_array_equal(labels, np.where(hidden, 255, 3))
    np.testing.assert_array_equal(confidence, np.where(hidden, 0, 200))


def test_polygons_hide_the_pixels_that_they_cover(tmp_path: Path) -> None:
    polygons = [
        {"class": "mast", "polygon": [[10, 20], [19, 20], [19, 143], [10, 143]]},
        {"class": "caption", "polygon": [[-5, -4], [260, -4], [260, 6], [-5, 6]], "reason": "over the edge is fine"},
    ]
    scene = site_scene_filter(load_site(site_with(tmp_path, polygons)), "mast")
    expected = np.zeros((MAST.height, MAST.width), np.bool_)
    expected[20:144, 10:20] = True
    expected[:7] = True
    assert scene.mask is not None
    np.testing.assert_array_equal(scene.mask, expected)


def test_pictures_that_are_too_large_have_no_mask_made(tmp_path: Path) -> None:
    """Of a calibration that nobody would see the memory for."""
    path = site_with(tmp_path, [{"polygon": [[0, 0], [9, 0], [9, 4], [0, 4]]}])
    content = yaml.safe_load(path.read_text())
    content["cameras"]["mast"]["calibration"] |= {"width": 60_000, "height": 50_000}
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(ConfigError, match=r"cameras\.mast\.calibration: images of 60000 x 50000 .* raise the limit"):
        site_scene_filter(load_site(path), "mast")
    content["cameras"]["mast"]["calibration"]["height"] = 10**29
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(ConfigError, match=r"calibration\.height: Input should be less than or equal to 65535"):
        load_site(path)


def wrong_files(folder: Path) -> dict[str, object]:
    rng = np.random.default_rng(1)
    shape = (MAST.height, MAST.width)
    Image.fromarray(np.zeros(shape, np.uint8)).save(folder / "empty.png")
    Image.fromarray(np.ones(shape, np.uint8)).save(folder / "full.png")
    Image.fromarray(np.eye(*shape[::-1], dtype=np.uint8)).save(folder / "turned.png")
    Image.fromarray(rng.integers(0, 255, (*shape, 3), np.uint8)).save(folder / "colours.png")
    Image.fromarray(np.eye(*shape, dtype=np.uint8) * 255).save(folder / "soft.jpg")
    (folder / "text.png").write_text("no picture")
    return {
        "empty.png": "hides nothing",
        "full.png": "hides the whole image.*inverted",
        "turned.png": "144 x 256 pixels, but the camera's images have 256 x 144",
        "colours.png": "has colours or transparency",
        "soft.jpg": "is a JPEG",
        "text.png": "cameras.mast.mask: .*unsupported format",
        "none.png": "cameras.mast.mask: .*cannot be read",
        "": "cameras.mast.mask: .*cannot be read",
    }


@pytest.mark.parametrize(
    "name", ["empty.png", "full.png", "turned.png", "colours.png", "soft.jpg", "text.png", "none.png", ""]
)
def test_a_mask_that_cannot_be_is_told_in_words(tmp_path: Path, name: str) -> None:
    said = wrong_files(tmp_path)[name]
    path = site_with(tmp_path, name)
    with pytest.raises(ConfigError, match=str(said)):
        site_scene_filter(load_site(path), "mast")
    found = [f for f in check_site(path).findings if f.name == "mast: mask"]
    assert [f.verdict for f in found] == [SiteVerdict.WRONG]


@pytest.mark.parametrize("away", ["../m.png", "/etc/hostname", "a/../../m.png", "link.png", "a\0b"])
def test_a_path_out_of_the_sites_folder_is_refused(tmp_path: Path, away: str) -> None:
    (tmp_path / "site").mkdir()
    write_mask(tmp_path / "m.png", corner())
    (tmp_path / "site/link.png").symlink_to(tmp_path / "m.png")
    if "\0" in away:
        path = site_with(tmp_path / "site", "x.png")
        path.write_text(path.read_text().replace("x.png", '"a\\0b"'))
        with pytest.raises(ConfigError):
            load_site(path)
        return
    with pytest.raises(ConfigError, match=r"cameras\.mast\.mask: .* is outside the site's folder"):
        load_site(site_with(tmp_path / "site", away))


@pytest.mark.parametrize(
    ("polygons", "said"),
    [
        ([{"polygon": [[300, 9], [310, 9], [310, 20]]}], r"cameras\.mast\.mask\.0: the polygon is outside"),
        ([{"polygon": [[-1, 0], [257, 0], [257, 150], [-1, 150]]}], "hides the whole image"),
    ],
)
def test_polygons_that_cannot_be_are_told_in_words(tmp_path: Path, polygons: object, said: str) -> None:
    site = load_site(site_with(tmp_path, polygons))
    with pytest.raises(ConfigError, match=said):
        site_scene_filter(site, "mast")


def test_a_camera_without_a_mask_hides_nothing(tmp_path: Path) -> None:
    scene = site_scene_filter(write_small_site(tmp_path, recording=False).site, "tower")
    assert scene.look(np.zeros((5, 7, 3), np.uint8)).hidden is None
