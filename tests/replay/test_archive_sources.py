from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
import s3fs
from scenes.own_disk import run_on_own_disk
from scenes.s3_bucket import empty_bucket
from scenes.small_site import FRAMES, SmallSite

from ltm_core.base.errors import ArchiveError
from ltm_core.pipeline.stored_fuel import STORE_FILE
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.image import encode_rgb
from ltm_ros.archive import files
from ltm_ros.archive.engine import serial
from ltm_ros.archive.files import CacheConfig
from ltm_ros.archive.run import ArchiveOptions, Summary, look_through, run
from ltm_ros.recordings.importing.build import import_photos

pytestmark = pytest.mark.usefixtures("without_page")


DISK = Path(__file__).parents[1] / "scenes" / "archive_disk_process.py"


def reprocessed(options: ArchiveOptions) -> Summary:
    return run(look_through(options, lambda done, total: None), serial, lambda done, total: None)


@dataclass
class Store:
    """A bucket with the recording. `refused`: of each request, how many more are."""

    address: str = ""
    refused: Counter[str] = field(default_factory=Counter)
    seen: Counter[str] = field(default_factory=Counter)

    def refuses(self, request: str) -> bool:
        self.seen[request] += 1
        self.refused[request] -= 1
        return self.refused[request] >= 0


@pytest.fixture
def store(small_site: SmallSite, monkeypatch: pytest.MonkeyPatch) -> Iterator[Store]:
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    monkeypatch.setattr(files, "TRIES", 3)
    monkeypatch.setattr(files, "FIRST_WAIT_S", 0.0)
    monkeypatch.setattr(s3fs.S3FileSystem, "retries", 1)
    store = Store()
    with empty_bucket("towers", store.refuses) as address:
        store.address = address
        s3fs.S3FileSystem().put(str(small_site.bag), f"{address}/year/bag", recursive=True)
        yield store


def test_an_archive_on_s3_gives_the_map_of_that_on_disk(
    small_site: SmallSite, store: Store, expected: str, tmp_path: Path
) -> None:
    """Also where two requests of three are refused."""
    recording = next(small_site.bag.glob("*.mcap")).name
    for method in ("GET", "HEAD"):
        store.refused[f"{method} /towers/year/bag/{recording}"] = 2
    options = ArchiveOptions(
        (f"{store.address}/year",), small_site.path, str(tmp_path / "out"), cache=CacheConfig(str(tmp_path / "cache"))
    )
    summary = reprocessed(options)
    assert (summary.digest, summary.worked, summary.failed) == (expected, 2 * FRAMES, 0)
    assert reprocessed(options).worked == 0
    single = replace(options, archives=(f"{store.address}/year/bag/{recording}",), out=str(tmp_path / "single"))
    assert reprocessed(single).digest == expected
    fetched = [name for name in store.seen if name.startswith("GET") and name.endswith(".mcap")]
    assert sum(store.seen[name] for name in fetched) == 3


def test_what_a_store_keeps_refusing_is_named_and_no_result(
    small_site: SmallSite, store: Store, expected: str, tmp_path: Path
) -> None:
    recording = next(small_site.bag.glob("*.mcap")).name
    request = f"GET /towers/year/bag/{recording}"
    store.refused[request] = 10**6
    options = ArchiveOptions(
        (f"{store.address}/year",),
        small_site.path,
        str(tmp_path / "out"),
        max_failed=1.0,
        cache=CacheConfig(str(tmp_path / "cache")),
    )
    with pytest.raises(ArchiveError, match=rf"1 recordings could not be read.*{recording} cannot be read now"):
        reprocessed(options)
    assert store.seen[request] == files.TRIES
    (failure,) = json.loads((tmp_path / "out/run.json").read_text())["failures"]
    assert failure["place"] == f"{store.address}/year/bag/{recording}"
    assert not (tmp_path / "out" / STORE_FILE).exists()
    store.refused.clear()
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
    small_site: SmallSite, store: Store, tmp_path: Path
) -> None:
    folder = write_photos(small_site, tmp_path / "photos")
    import_photos([folder], tmp_path / "bag", folder / "poses.csv", small_site.site)
    options = ArchiveOptions((tmp_path / "bag",), small_site.path, str(tmp_path / "of_bag"))
    of_bag = reprocessed(options)
    assert (of_bag.merged, of_bag.failed) == (FRAMES, 0)
    infos = BagReader(tmp_path / "bag").topic_infos()
    assert {info.message_count for topic, info in infos.items() if topic != "/tf_static"} == {FRAMES}
    of_folder = reprocessed(replace(options, archives=(folder,), out=str(tmp_path / "of_folder")))
    assert (of_folder.digest, of_folder.worked) == (of_bag.digest, FRAMES)
    # The same photos in both count once, and their votes have the same names.
    both = look_through(replace(options, archives=(folder, tmp_path / "bag")), lambda done, total: None)
    assert (both.manifest.repeated, both.manifest.failures) == (FRAMES, [])
    assert run(both, serial, lambda done, total: None).worked == 0
    s3fs.S3FileSystem().put(str(folder), f"{store.address}/photos", recursive=True)
    on_s3 = replace(options, archives=(f"{store.address}/photos",), out=str(tmp_path / "of_s3"))
    small_cache = CacheConfig(str(tmp_path / "cache"), max(file.stat().st_size for file in folder.iterdir()))
    assert reprocessed(replace(on_s3, cache=small_cache)).digest == of_bag.digest
