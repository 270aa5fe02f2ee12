import os
from pathlib import Path

import pytest
from pydantic import ValidationError
from scenes.source_under_test import MOST_BYTES, Sourced, TurnedClock, settings
from scenes.timed_picture import exif_of, jpeg, scene

from ltm_ros.cameras.protocols.credentials import PictureError
from ltm_ros.cameras.protocols.files import FolderReader
from ltm_ros.cameras.protocols.picture import CameraImage, Nothing

NOW = 1_790_000_000.0


def write(path: Path, data: bytes, age: float = 0.0) -> bytes:
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)
    os.utime(path, (NOW - age, NOW - age))
    return data


def reader(folder: Path, **given: object) -> FolderReader:
    return FolderReader(settings(kind="folder", path=str(folder), **given), MOST_BYTES, TurnedClock(NOW))


def given_by(asking: FolderReader, looks: int = 8) -> list[bytes | None]:
    found = (asking.read() for _ in range(looks))
    return [item.jpeg for item in found if isinstance(item, CameraImage)]


def test_files_come_once_in_the_order_in_which_they_were_written(tmp_path: Path) -> None:
    later, sooner = write(tmp_path / "a.jpg", jpeg(scene()), 5.0), write(tmp_path / "b.jpg", jpeg(scene()), 9.0)
    write(tmp_path / "c.txt", jpeg(scene()))
    write(tmp_path / "old.jpg", jpeg(scene()), 5000.0)
    asking = reader(tmp_path)
    assert given_by(asking) == [sooner, later]
    again = write(tmp_path / "a.jpg", jpeg(scene()), 1.0)
    assert given_by(asking) == [again]


def test_a_file_that_is_being_written_is_waited_for(tmp_path: Path) -> None:
    whole = jpeg(scene())
    asking = reader(tmp_path)
    for part in (0.2, 0.5, 0.9):
        write(tmp_path / "a.jpg", whole[: int(len(whole) * part)])
        assert [asking.read() for _ in range(3)] == [Nothing.YET] * 3
    write(tmp_path / "a.jpg", whole)
    assert given_by(asking) == [whole]


def test_an_upload_that_broke_off_is_said_and_does_not_hold_up_the_next(tmp_path: Path) -> None:
    clock = TurnedClock(NOW)
    asking = FolderReader(
        settings(kind="folder", path=str(tmp_path), complete_within=60, delete=True), MOST_BYTES, clock
    )
    write(tmp_path / "a.jpg", jpeg(scene())[:900])
    assert given_by(asking, 2) == []
    whole = write(tmp_path / "b.jpg", jpeg(scene()))
    assert given_by(asking, 2) == [whole]
    clock.turn(61.0)
    with pytest.raises(PictureError, match=r"a\.jpg has 900 bytes and no end of image after 61 s"):
        asking.read()
    assert list(tmp_path.iterdir()) == []


def test_nothing_outside_the_folder_is_read(tmp_path: Path) -> None:
    home, secret = tmp_path / "drop", tmp_path / "secret.jpg"
    write(secret, jpeg(scene()))
    home.mkdir()
    (home / "link.jpg").symlink_to(secret)
    (home / "below").symlink_to(tmp_path)
    for pattern in ("**/*.jpg", "*/*.jpg"):
        assert given_by(reader(home, pattern=pattern)) == []
    assert secret.is_file()
    for pattern in ("../*.jpg", "/etc/*", "a/../../*.jpg", ""):
        with pytest.raises(ValidationError, match="below the folder"):
            settings(kind="folder", path=str(home), pattern=pattern)


def test_files_too_large_and_names_without_a_time_are_refused(tmp_path: Path) -> None:
    write(tmp_path / "huge.jpg", b"\xff\xd8\xff" + bytes(MOST_BYTES))
    asking = reader(tmp_path, name_time="north_%Y%m%d-%H%M%S.jpg")
    asking.read()
    with pytest.raises(PictureError, match=f"maximum is {MOST_BYTES}"):
        asking.read()
    write(tmp_path / "north.jpg", jpeg(scene()))
    asking.read()
    with pytest.raises(PictureError, match="correct name_time"):
        asking.read()


@pytest.mark.parametrize("where", ["name", "exif"])
def test_the_time_is_that_of_a_trusted_cameras_name_or_exif(tmp_path: Path, where: str) -> None:
    # 2026-09-21 13:33:20 UTC is 1_789_997_600.
    exif = exif_of("2026:09:21 06:33:20")
    write(tmp_path / "north_20260921-063320.jpg", jpeg(scene(), exif=exif), 3.0)
    given = {"name_time": "north_%Y%m%d-%H%M%S.jpg"} if where == "name" else {}
    config = settings(kind="folder", path=str(tmp_path), zone="America/Los_Angeles", clock="trusted", **given)
    sourced = Sourced(config, TurnedClock(NOW))
    sourced.steps(3)
    (frame,) = sourced.frames
    assert (frame.told_by, frame.uncertainty) == (where, pytest.approx(0.52))
    assert frame.stamp_ns / 1e9 == pytest.approx(1_789_997_600.5, abs=1e-3)
