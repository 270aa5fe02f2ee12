"""`ltm reprocess` of archives on disks that fail, and of folders of photos."""

from __future__ import annotations

import csv
import errno
import gc
from dataclasses import replace
from pathlib import Path
from weakref import WeakSet

import pytest
from mcap.records import Chunk
from scenes.own_disk import run_on_own_disk
from scenes.small_site import FRAMES, SmallSite

from ltm_core.base.errors import ArchiveError
from ltm_msgs_py.bag.cdr import CompressedPicture
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.image import encode_rgb
from ltm_ros.archive import scan as photo_folder
from ltm_ros.archive.run import ArchiveOptions, Summary, look_through, run
from ltm_ros.archive.task import serial
from ltm_ros.recordings.importing.build import import_photos

DISK = Path(__file__).parents[1] / "scenes" / "archive_disk_process.py"


def reprocessed(options: ArchiveOptions) -> Summary:
    return run(look_through(options, lambda done, total: None), serial, lambda done, total: None)


def test_a_disk_that_fails_for_a_while_is_no_result(
    small_site: SmallSite, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a network's file system does: chunks of a recording that cannot be read are not chunks that are broken."""

    def failing(stream: object) -> Chunk:
        raise OSError(errno.EIO, "Input/output error")

    options = ArchiveOptions((small_site.bag,), small_site.path, tmp_path / "out", max_failed=1.0)
    with monkeypatch.context() as patched:
        patched.setattr(Chunk, "read", failing)
        with pytest.raises(ArchiveError, match=r"cannot be read now: .*Input/output error"):
            reprocessed(options)
    planned = look_through(options, lambda done, total: None)
    with monkeypatch.context() as patched:
        patched.setattr(Chunk, "read", failing)
        with pytest.raises(ArchiveError, match="Input/output error"):
            run(planned, serial, lambda done, total: None)
    assert reprocessed(options).digest == expected


def test_a_disk_that_fills_up_while_a_run_writes_is_named_and_the_run_goes_on_when_there_is_room(
    small_site: SmallSite, expected: str, tmp_path: Path
) -> None:
    (tmp_path / "disk").mkdir()
    found = run_on_own_disk(DISK, "full", tmp_path / "disk", small_site.folder)
    assert "No space left on device" in found["said"]
    assert (found["maps"], found["partial"]) == ([], []), "no map, and no file that is not whole"
    assert (found["digest"], found["frames"]) == (expected, 2 * FRAMES)
    assert 0 < found["worked"] < 2 * FRAMES, "what was done before stays done"


def write_photos(site: SmallSite, folder: Path) -> Path:
    """Of the tower, with all that is known of them in a pose list."""
    folder.mkdir()
    rows = []
    for number, frame in enumerate(f for f in site.frames() if f.camera_name == "tower"):
        name = f"{number:03}.jpg"
        (folder / name).write_bytes(encode_rgb(site.photo(frame), quality=95))
        x, y, z = frame.pose.position
        azimuth, pitch, roll = frame.pose.angles_deg
        origin = site.site.frame
        stamp = f"2023-11-14T22:13:{20 + number // 4:02}.{250 * (number % 4):03}Z"
        rows.append(
            {"name": name, "camera": "tower", "stamp": stamp}
            | {"x": x + origin.x_origin, "y": y + origin.y_origin, "z": z}
            | {"azimuth_deg": azimuth, "pitch_deg": pitch, "roll_deg": roll}
            | {key: getattr(frame.camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
        )
    with (folder / "poses.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return folder


def test_a_folder_of_photos_gives_the_map_of_the_recording_that_import_makes_of_it(
    small_site: SmallSite, tmp_path: Path
) -> None:
    folder = write_photos(small_site, tmp_path / "photos")
    import_photos([folder], tmp_path / "bag", folder / "poses.csv", small_site.site)
    options = ArchiveOptions((tmp_path / "bag",), small_site.path, tmp_path / "of_bag")
    of_bag = reprocessed(options)
    assert (of_bag.merged, of_bag.failed) == (FRAMES, 0)
    infos = BagReader(tmp_path / "bag").topic_infos()
    assert {info.message_count for topic, info in infos.items() if topic != "/tf_static"} == {FRAMES}
    of_folder = reprocessed(replace(options, archives=(folder,), out=tmp_path / "of_folder"))
    assert (of_folder.digest, of_folder.worked) == (of_bag.digest, FRAMES)
    # The same photos in both count once, and their votes have the same names.
    both = look_through(replace(options, archives=(folder, tmp_path / "bag")), lambda done, total: None)
    assert (both.manifest.repeated, both.manifest.failures) == (FRAMES, [])
    assert run(both, serial, lambda done, total: None).worked == 0


def test_one_photo_of_a_folder_is_held_at_a_time(
    small_site: SmallSite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A year of them would not fit."""
    held, most, make = WeakSet[CompressedPicture](), list[int](), photo_folder.photo_picture

    def noted(data: bytes, stamp_ns: int) -> CompressedPicture:
        picture = make(data, stamp_ns)
        gc.collect()
        held.add(picture)
        most.append(len(held))
        return picture

    monkeypatch.setattr(photo_folder, "photo_picture", noted)
    folder = write_photos(small_site, tmp_path / "photos")
    look_through(ArchiveOptions((folder,), small_site.path, tmp_path / "out"), lambda done, total: None)
    assert len(most) == FRAMES
    assert max(most) <= 2


def test_photos_that_cannot_be_taken_are_named(small_site: SmallSite, tmp_path: Path) -> None:
    folder = write_photos(small_site, tmp_path / "photos")
    (folder / "001.jpg").write_bytes(b"\xff\xd8 and no more")
    (folder / "002.jpg").unlink()
    options = ArchiveOptions((folder,), small_site.path, tmp_path / "out", max_failed=0.5)
    summary = reprocessed(options)
    assert (summary.merged, summary.failed) == (FRAMES - 2, 2)
    assert {failure.place for failure in summary.failures} == {"tower"}
