from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image
from scenes.command_line import ltm
from scenes.small_site import NAME, write_small_site
from scenes.tower_pictures import HEIGHT, WIDTH, corners, tower_picture

from ltm_core.base.errors import LtmError
from ltm_core.site.networks import site_scene_filter
from ltm_core.site.site_io import load_site
from ltm_core.vision.areas import read_areas
from ltm_core.vision.masks import Looking
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import compressed_to_msg, encode_rgb
from ltm_msgs_py.pose import pose_to_msg
from ltm_ros.runtime.topics import IMAGE_COMPRESSED, POSE, camera_topic


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    for seed in (1, 2, 3):
        Image.fromarray(tower_picture(seed)).save(folder / f"west_{seed}.png")
    Image.fromarray(np.zeros((30, 40, 3), np.uint8)).save(folder / "other.png")
    return folder


def test_a_person_confirms_what_is_proposed(photos: Path, tmp_path: Path) -> None:
    site = write_small_site(tmp_path, recording=False).path
    given = [photos, "--only", "west*", "--site", site, "--camera", "tower"]
    out = ltm("mask", *given)
    assert "confirm with --keep" in out
    numbers = [area.number for area in read_areas(tmp_path / "tower_mask.json") if area.kind == "lens"]
    kept = ltm("mask", *given, "--keep", ",".join(str(n) for n in numbers))
    line = yaml.safe_load(kept[kept.index("cameras:") :])
    assert line == {"cameras": {"tower": {"mask": "tower_mask.png"}}}
    content = yaml.safe_load(site.read_text())
    content["cameras"]["tower"].update(line["cameras"]["tower"])
    site.write_text(yaml.safe_dump(content))
    hidden = site_scene_filter(load_site(site), "tower").hidden(WIDTH, HEIGHT)
    assert hidden is not None
    assert (hidden & corners()).sum() > 0.95 * corners().sum()
    assert {area.kind for area in read_areas(tmp_path / "tower_mask.json")} == {"lens"}
    with Image.open(tmp_path / "tower_mask_proposals.png") as picture:
        assert picture.size == (WIDTH, HEIGHT)


def test_of_a_turning_camera_the_pictures_of_one_view_are_taken(tmp_path: Path) -> None:
    small = write_small_site(tmp_path, recording=False)
    with BagWriter(tmp_path / "bag") as bag:
        for seed, azimuth in ((1, 10.0), (2, 70.2), (3, 69.9)):
            stamp = seed * 10**9
            message = compressed_to_msg(encode_rgb(tower_picture(seed), quality=95), "jpeg", stamp, "o")
            bag.write(camera_topic(NAME, "tower", IMAGE_COMPRESSED), message, stamp)
            bag.write(camera_topic(NAME, "tower", POSE), pose_to_msg(small.tower_pose(azimuth), stamp), stamp)
    given = [tmp_path / "bag", "--site", small.path, "--camera", "tower", "--view", "east"]
    out = ltm("mask", *given, "--looking", "70,-14", "--keep", "all")
    assert "2 images of one camera" in out
    (line,) = yaml.safe_load(out[out.index("cameras:") :])["cameras"]["tower"]["view_masks"]
    assert line == {"name": "east", "azimuth_deg": 70.0, "pitch_deg": -14.0, "mask": "tower_east_mask.png"}
    content = yaml.safe_load(small.path.read_text())
    content["cameras"]["tower"]["view_masks"] = [line]
    small.path.write_text(yaml.safe_dump(content))
    scene = site_scene_filter(load_site(small.path), "tower")
    assert scene.hidden(WIDTH, HEIGHT, Looking(10.0, -14.0, 62.0)) is None
    hidden = scene.hidden(WIDTH, HEIGHT, Looking(70.2, -14.0, 62.0))
    assert hidden is not None
    assert (hidden & corners()).any()
    with pytest.raises(LtmError, match="no image of tower has a pose in the direction of view east"):
        ltm("mask", *given, "--looking", "200,-14", "--keep", "all")


def test_mistakes_are_told_in_words(photos: Path, tmp_path: Path) -> None:
    out = ["--out", tmp_path / "m.png"]
    with pytest.raises(LtmError, match="different sizes"):
        ltm("mask", photos, *out)
    with pytest.raises(LtmError, match="--site and --camera together"):
        ltm("mask", photos, "--camera", "west", *out)
    with pytest.raises(LtmError, match="--view and --looking together"):
        ltm("mask", photos, "--view", "west", *out)
    for said in ("70", "70,west", "70,-14,30,5", "500,0"):
        with pytest.raises(LtmError, match="--looking"):
            ltm("mask", photos, "--view", "west", "--looking", said, *out)
    with pytest.raises(LtmError, match="no photos match 'east"):
        ltm("mask", photos, "--only", "east*", *out)
    with pytest.raises(LtmError, match="there is no proposal 99"):
        ltm("mask", photos, "--only", "west*", "--keep", "1,99", *out)
    with pytest.raises(LtmError, match="expected numbers of proposals"):
        ltm("mask", photos, "--only", "west*", "--keep", "one", *out)
    assert "nothing to mask" in ltm("mask", photos, "--only", "west*", "--keep", "none", *out)
    assert not (tmp_path / "m.png").exists()
