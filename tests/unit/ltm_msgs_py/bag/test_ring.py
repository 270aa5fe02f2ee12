import errno
import os
from pathlib import Path

import pytest
import yaml
from mcap.writer import CompressionType
from rosbags.rosbag2 import Reader
from std_msgs.msg import String

from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.ring import RecordingRing
from ltm_msgs_py.bag.writer import BagWriter, Split


def record(ring: RecordingRing, folder: Path, count: int, first: int = 0) -> Path:
    """A bag with a file for each message."""
    with BagWriter(folder, compression=CompressionType.NONE, split=Split(1, 1 << 62), library=ring.library) as writer:
        for i in range(first, first + count):
            writer.write("/a", String(data=f"{i}:" + "x" * 15_000), i)
            writer.flush()
    return folder


def numbers(bag: Path) -> list[int]:
    reader = BagReader(bag, allow_damaged=False)
    return [int(reader.decode(m).data.partition(":")[0]) for m in reader.messages()]


@pytest.fixture
def ring(tmp_path: Path) -> RecordingRing:
    return RecordingRing(tmp_path / "bag", "/ridge/recorder", None)


def bounded(ring: RecordingRing, path: Path, most_bytes: int) -> RecordingRing:
    return RecordingRing(path, "/ridge/recorder", most_bytes)


def test_the_oldest_files_go_and_each_bag_stays_whole(ring: RecordingRing, tmp_path: Path) -> None:
    first = record(ring, ring.new_folder(), 3)
    second = record(ring, ring.new_folder(), 3, first=3)
    assert (first.name, second.name) == ("bag", "bag_1")
    size = ring.files()[0].stat().st_size
    assert [f.name for f in ring.files()] == [
        *(f"bag_{i}.mcap" for i in range(3)),
        *(f"bag_1_{i}.mcap" for i in range(3)),
    ]
    assert bounded(ring, first, 6 * size + 600).make_room(0) == []
    removed = bounded(ring, first, 6 * size + 600).make_room(2 * size)
    assert [p.name for p in removed] == ["bag_0.mcap", "bag_1.mcap"]
    assert (numbers(first), numbers(second)) == ([2], [3, 4, 5])
    info = yaml.safe_load((first / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (info["relative_file_paths"], info["message_count"]) == (["bag_2.mcap"], 1)
    assert info["topics_with_message_count"][0]["message_count"] == 1
    with Reader(first) as reader:
        assert reader.message_count == 1
    assert len(bounded(ring, first, 1).make_room(0)) == 4
    assert sorted(p.name for p in tmp_path.iterdir()) == [], "a bag without files goes too"


def test_marked_files_stay_and_do_not_count(ring: RecordingRing) -> None:
    first = record(ring, ring.new_folder(), 3)
    second = record(ring, ring.new_folder(), 2)
    third = record(ring, ring.new_folder(), 2)
    (first / "bag_1.mcap.keep").touch()
    (second / ".keep").touch()
    marked = {first / "bag_1.mcap", *second.glob("*.mcap")}
    assert ring.sizes() == {file: file.stat().st_size for file in ring.files() if file not in marked}
    assert len(list(third.glob("*.mcap"))) == 2
    bounded(ring, first, 1).make_room(0)
    assert [f.name for f in ring.files()] == ["bag_1.mcap", "bag_1_0.mcap", "bag_1_1.mcap"]
    assert numbers(first) == [1]


def test_nothing_that_the_recorder_did_not_write_is_touched(ring: RecordingRing, tmp_path: Path) -> None:
    bag = record(ring, ring.new_folder(), 1)
    elsewhere = record(ring, tmp_path / "elsewhere" / "bag", 1)
    of_another = RecordingRing(tmp_path / "bag", "/canyon/recorder", None)
    foreign = record(of_another, tmp_path / "bag_7", 1)
    linked = tmp_path / "bag_8"
    linked.symlink_to(elsewhere)
    (bag / "bag_5.mcap").symlink_to(elsewhere / "bag_0.mcap")
    (bag / "bag_6.mcap").write_bytes(b"no recording")
    (bag / "notes.mcap").write_bytes((bag / "bag_0.mcap").read_bytes())
    alike = record(ring, tmp_path / "bag_2_1", 1)
    assert bounded(ring, bag, 1).make_room(0) == [bag / "bag_0.mcap"]
    assert sorted(p.name for p in bag.iterdir()) == ["bag_5.mcap", "bag_6.mcap", "notes.mcap"]
    assert numbers(elsewhere) == numbers(foreign) == numbers(alike) == [0]


def test_a_file_that_is_being_written_stays(ring: RecordingRing) -> None:
    folder = ring.new_folder()
    with BagWriter(folder, library=ring.library) as writer:
        writer.write("/a", String(data="x"), 1)
        writer.flush()
        assert bounded(ring, folder, 1).make_room(0) == []
    assert BagReader(folder, allow_damaged=False).topic_infos()["/a"].message_count == 1


def test_a_bag_comes_after_all_that_are_there(ring: RecordingRing, tmp_path: Path) -> None:
    assert ring.new_folder() == tmp_path / "bag"
    (tmp_path / "bag").mkdir()
    assert ring.new_folder() == tmp_path / "bag"
    (tmp_path / "bag_3").mkdir()
    (tmp_path / "bag_x").mkdir()
    assert ring.new_folder() == tmp_path / "bag_4"
    (tmp_path / "bag_10").write_text("not ours")
    assert ring.new_folder() == tmp_path / "bag_11"


def test_a_disk_that_is_read_only_after_a_power_cut_keeps_no_recorder_from_its_start(
    ring: RecordingRing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It waits for the disk then; an error here would end it at each start."""
    bag = record(ring, ring.new_folder(), 2)
    (bag / "metadata.yaml").unlink()
    reserve = bag / ".bag_1.mcap.reserve"
    reserve.touch()
    unlink = Path.unlink

    def refuse(path: Path, missing_ok: bool = False) -> None:
        if path == reserve:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))
        unlink(path, missing_ok)

    with monkeypatch.context() as read_only:
        read_only.setattr(Path, "unlink", refuse)
        assert ring.repair() == []
    assert ring.repair() == [bag]
    assert numbers(bag) == [0, 1]
