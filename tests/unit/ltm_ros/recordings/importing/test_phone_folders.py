import re
from pathlib import Path

import numpy as np
import pytest
import typer
from scenes.phone_site import GROUND, imported, picture
from typer.testing import CliRunner
from unit.ltm_ros.recordings.importing.test_photos import LEVEL, images_of, phone, save, site

from ltm_core.site.site import Site
from ltm_core.storage.image_io import decode_rgb
from ltm_msgs_py.image import compressed_to_rgb
from ltm_ros.cli.record import import_
from ltm_ros.recordings.importing.build import import_photos
from ltm_ros.recordings.importing.pictures import find_pictures

__all__ = ["site"]
VIDEO = b"\0\0\0\x18ftypmp42\0\0\0\0mp42isom" + bytes(range(256)) * 20


def phone_folder(folder: Path) -> Path:
    """Return a folder with each kind of file that phones write; only the photos are real."""
    for name in ("100APPLE", "101APPLE", "raw"):
        (folder / name).mkdir(parents=True)
    for i, name in enumerate(("100APPLE/IMG_0001.HEIC", "100APPLE/IMG_0002.JPG", "101APPLE/IMG_0002.JPG")):
        save(folder / name, phone(**{"photo_0x9003": f"2024:07:04 18:30:{20 + i}"}))
    for name in ("100APPLE/IMG_0001.MOV", "100APPLE/IMG_0002.mov"):
        (folder / name).write_bytes(VIDEO)
    others = (
        "raw/IMG_0003.DNG",
        "dem.tif",
        "IMG_0001.AAE",
        "100APPLE/._IMG_0002.JPG",
        ".IMG_0009.HEIC.icloud",
        "broken.mp4",
    )
    for name in others:
        (folder / name).write_bytes(b"\0\5\x16\7")
    return folder


def test_every_file_of_a_phone_is_accounted_for(tmp_path: Path) -> None:
    found, skipped = find_pictures([phone_folder(tmp_path)], LEVEL)
    # Two photos have the same name, so these carry their folder.
    assert [picture.name for picture in found] == ["IMG_0001.HEIC", "100APPLE/IMG_0002.JPG", "101APPLE/IMG_0002.JPG"]
    reasons = {file.path.relative_to(tmp_path).as_posix(): file.why.split(";")[0] for file in skipped}
    assert reasons == {
        ".IMG_0009.HEIC.icloud": "only in iCloud",
        "100APPLE/IMG_0001.MOV": "video",
        "100APPLE/IMG_0002.mov": "video",
        "IMG_0001.AAE": "not a supported photo",
        "broken.mp4": "video",
        "dem.tif": "TIFF, perhaps a map",
        "raw/IMG_0003.DNG": "raw photo",
    }


def test_photos_of_one_name_stay_apart(tmp_path: Path, site: Site) -> None:
    folder = phone_folder(tmp_path / "photos")
    (tmp_path / "poses.csv").write_text("name,z\n100APPLE/IMG_0002.JPG,1790\n101APPLE/IMG_0002,1800\nIMG_0001,1810\n")
    import_photos([folder], tmp_path / "bag", tmp_path / "poses.csv", site, assumed=LEVEL)
    assert [pose.position[2] for _, _, pose, _ in imported(tmp_path / "bag")] == [1810.0, 1790.0, 1800.0]


def test_a_motion_photos_video_is_cut_off(tmp_path: Path, site: Site) -> None:
    path = save(tmp_path / "PXL_1.MP.jpg", phone())
    photo = path.read_bytes()
    path.write_bytes(photo + VIDEO)
    import_photos([path], tmp_path / "bag", site=site, assumed=LEVEL)
    (image,) = images_of(tmp_path / "bag")
    assert bytes(image.data) == photo


@pytest.mark.parametrize("name", ["a.webp", "a.TIF", "a.avif", "a.heic"])
def test_other_formats_are_imported_as_jpeg(tmp_path: Path, site: Site, name: str) -> None:
    report = import_photos([save(tmp_path / name, phone())], tmp_path / "bag", site=site, assumed=LEVEL)
    ((_, camera, pose, _),), (image,) = imported(tmp_path / "bag"), images_of(tmp_path / "bag")
    assert (report.cameras, image.format, camera.width) == ({"phone": 1}, "jpeg", picture().shape[1])
    assert pose.position[2] == pytest.approx(GROUND + 12.0)
    assert np.abs(compressed_to_rgb(image).astype(int) - picture()).mean() < 8


def test_the_command_ends_with_a_table_of_all_files(tmp_path: Path) -> None:
    folder = phone_folder(tmp_path / "photos")
    (folder / "empty.jpg").touch()
    whole = save(folder / "whole.jpg", phone()).read_bytes()
    (folder / "cut.jpg").write_bytes(whole[: len(whole) * 2 // 3] + b"\xff\xd9")
    app = typer.Typer()
    app.command()(import_)
    arguments = [str(folder), "--out", str(tmp_path / "bag"), "--skip-bad", "--pitch-deg", "0"]
    result = CliRunner().invoke(app, arguments, env={"COLUMNS": "300"}, catch_exceptions=False)
    assert result.exit_code == 0
    rows = re.findall(r"(imported|rejected|skipped)\W+(\d+)\W+?(\S[^│\n]*)", result.output)
    counts = [(word, int(number)) for word, number, _ in rows]
    assert counts.count(("rejected", 1)) == 2
    assert ("imported", 4) in counts
    assert sum(number for word, number in counts if word == "skipped") == 7
    assert decode_rgb(whole).shape == picture().shape
