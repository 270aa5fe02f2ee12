import errno
import os
import signal
import struct
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rclpy.serialization import serialize_message
from std_msgs.msg import Header, String

from ltm_core.base.errors import RecordingError
from ltm_msgs_py.bag.mcap_index import McapIndex
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.repair import finish_cut_file, repair_bag
from ltm_msgs_py.bag.schemas import schema_text
from ltm_msgs_py.bag.writer import BagWriter, Split


def information(bag: Path) -> dict[str, object]:
    document = yaml.safe_load((bag / "metadata.yaml").read_text())
    info = document["rosbag2_bagfile_information"]
    assert isinstance(info, dict)
    return info


def test_the_layout_is_rosbag2s(tmp_path: Path) -> None:
    bag = tmp_path / "walk"
    with BagWriter(bag, custom_data={"ltm_site": "ridge"}) as writer:
        writer.add_topic("/ridge/info", "std_msgs/msg/String", latched=True)
        writer.write("/ridge/info", String(data="a"), 5_000)
        writer.write("/ridge/note", String(data="b"), 9_000, 8_000)
    assert sorted(p.name for p in bag.iterdir()) == ["metadata.yaml", "walk_0.mcap"]
    info = information(bag)
    assert (info["version"], info["storage_identifier"], info["message_count"]) == (9, "mcap", 2)
    assert info["starting_time"] == {"nanoseconds_since_epoch": 5_000}
    assert info["duration"] == {"nanoseconds": 4_000}
    assert info["relative_file_paths"] == ["walk_0.mcap"]
    assert info["custom_data"] == {"ltm_site": "ridge"}

    with (bag / "walk_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        (record,) = reader.iter_metadata()
        messages = list(reader.iter_messages())
    assert record.name == "rosbag2"
    assert yaml.safe_load(record.metadata["serialized_metadata"]) == info
    schema, channel, message = messages[1]
    assert (schema.name, schema.encoding, channel.message_encoding) == ("std_msgs/msg/String", "ros2msg", "cdr")
    assert (message.log_time, message.publish_time, message.sequence) == (9_000, 8_000, 0)
    (qos,) = yaml.safe_load(messages[0][1].metadata["offered_qos_profiles"])
    assert (qos["durability"], qos["reliability"], qos["history"]) == ("transient_local", "reliable", "keep_last")


@pytest.mark.parametrize(
    ("act", "complaint"),
    [
        (lambda w: w.write("/a", Header(), 2), "/a holds std_msgs/msg/String"),
        (lambda w: w.write_raw("/a", "std_msgs/msg/Header", bytes(8), 2), "/a holds std_msgs/msg/String"),
        (lambda w: w.add_topic("/a", "std_msgs/msg/Header"), "/a is already"),
        (lambda w: w.add_topic("/a", "std_msgs/msg/String", latched=True), "/a is already"),
        (lambda w: w.write("note", String(), 2), "'note' must be absolute"),
        (lambda w: w.write_raw("/b", "acme/msg/Rocket", bytes(8), 2), "acme/msg/Rocket"),
        (lambda w: w.write_raw("/b", "Rocket", bytes(8), 2), "package/msg/Message"),
        (lambda w: w.write_raw("/a", "std_msgs/msg/String", b"", 2), "0 bytes for /a are not a CDR"),
        (lambda w: w.write_raw("/a", "std_msgs/msg/String", b'{"data": 1}', 2), "not a CDR"),
        (lambda w: w.write("/a", String(), -1), "log -1"),
        (lambda w: w.write("/a", String(), 1, -5), "publish -5"),
        (lambda w: w.write("/a", String(), 2**63), str(2**63)),
    ],
)
def test_what_cannot_be_written_is_refused_and_the_rest_stays(
    tmp_path: Path, act: Callable[[BagWriter], None], complaint: str
) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/a", String(data="first"), 1)
        with pytest.raises(RecordingError, match=complaint):
            act(writer)
        writer.write("/a", String(data="last"), 3)
    reader = BagReader(tmp_path / "bag")
    assert [reader.decode(m).data for m in reader.messages()] == ["first", "last"]


def test_nothing_that_exists_is_overwritten(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/a", String(data="kept"), 1)
    with pytest.raises(RecordingError, match="exists already"):
        BagWriter(tmp_path / "bag")
    (tmp_path / "file").write_text("kept")
    with pytest.raises(RecordingError, match="exists already"):
        BagWriter(tmp_path / "file")
    with pytest.raises(RecordingError, match="cannot write a bag"):
        BagWriter(tmp_path / "file" / "below")
    assert BagReader(tmp_path / "bag").topic_infos()["/a"].message_count == 1


def test_metadata_appears_only_when_the_bag_is_finished_also_after_an_error(tmp_path: Path) -> None:
    bag = tmp_path / "bag"

    def record() -> None:
        with BagWriter(bag) as writer:
            writer.write("/a", String(data="kept"), 1)
            assert not (bag / "metadata.yaml").exists()
            raise KeyError("something else went wrong")

    with pytest.raises(KeyError):
        record()
    assert information(bag)["message_count"] == 1


@pytest.mark.parametrize("readable", [True, False])
def test_a_disk_that_fails_ends_the_file_whole_and_the_next_message_begins_another(
    tmp_path: Path, readable: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not readable:
        monkeypatch.setattr(McapIndex, "open", lambda path: BagReader(path / "absent"))
    writer = BagWriter(tmp_path / "bag", compression=CompressionType.NONE, chunk_size=25_000)
    writer.write("/a", String(data="0" * 10_000), 0)
    writer.flush()
    (bag,) = (tmp_path / "bag").glob("*.mcap")
    (descriptor,) = (int(link.name) for link in Path("/proc/self/fd").iterdir() if os.path.realpath(link) == str(bag))
    with Path("/dev/full").open("wb", buffering=0) as full:
        os.dup2(full.fileno(), descriptor)
        for i in (1, 2):
            writer.write("/a", String(data=str(i) * 10_000), i)
        with pytest.raises(RecordingError, match="No space left on device; 3 messages are lost, the 1 before them"):
            writer.write("/a", String(data="3" * 10_000), 3)
    assert (writer.on_disk, writer.lost) == ({"/a": 1}, 3)
    writer.write("/a", String(data="4" * 10_000), 4)
    assert writer.on_disk == {"/a": 1}, "it waits for its chunk"
    writer.close()
    assert (writer.on_disk, writer.lost) == ({"/a": 2}, 3)
    monkeypatch.undo()
    reader = BagReader(tmp_path / "bag", allow_damaged=not readable)
    assert [reader.decode(m).data[0] for m in reader.messages()] == ["0", "4"]
    assert information(tmp_path / "bag")["message_count"] == 2
    assert sorted(p.name for p in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "bag_1.mcap", "metadata.yaml"]


def test_a_bag_of_several_files(tmp_path: Path) -> None:
    split = Split(most_bytes=9_000, longest_ns=1_000)
    with BagWriter(tmp_path / "bag", compression=CompressionType.NONE, chunk_size=2_000, split=split) as writer:
        writer.add_topic("/info", "std_msgs/msg/String", latched=True)
        writer.write("/info", String(data="palette"), 0)
        for i in range(9):
            writer.write("/a", String(data=str(i) * 3_000), 10 * i)
        writer.write("/a", String(data="9"), 1_070)
        assert writer.on_disk.total() >= 9
    info = information(tmp_path / "bag")
    names = [f"bag_{i}.mcap" for i in range(4)]
    assert info["relative_file_paths"] == names
    assert [(f["path"], f["message_count"]) for f in info["files"]] == list(zip(names, (4, 4, 4, 2), strict=True))
    assert (info["message_count"], writer.on_disk) == (14, {"/a": 10, "/info": 1})
    assert info["starting_time"] == {"nanoseconds_since_epoch": 0}
    assert info["duration"] == {"nanoseconds": 1_070}
    counts = {t["topic_metadata"]["name"]: t["message_count"] for t in info["topics_with_message_count"]}
    assert counts == {"/info": 4, "/a": 10}
    reader = BagReader(tmp_path / "bag", allow_damaged=False)
    assert [reader.decode(m).data[0] for m in reader.messages(["/a"])] == list("0123456789")
    for name in names:
        alone = BagReader(tmp_path / "bag" / name, allow_damaged=False)
        first = next(alone.messages())
        assert alone.decode(first).data == "palette", "each file can be read without those before it"
        assert alone.topic_infos()["/info"].latched


def test_what_was_flushed_survives_sigkill(tmp_path: Path) -> None:
    script = f"""
        import os, signal
        from std_msgs.msg import String
        from ltm_msgs_py.bag.writer import BagWriter
        writer = BagWriter({str(tmp_path / "bag")!r})
        for i in range(7):
            writer.write("/a", String(data=str(i)), i)
        writer.flush()
        writer.write("/a", String(data="lost"), 8)
        os.kill(os.getpid(), signal.SIGKILL)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], check=False)
    assert done.returncode == -signal.SIGKILL
    reader = BagReader(tmp_path / "bag")
    assert [reader.decode(m).data for m in reader.messages()] == [str(i) for i in range(7)]
    assert any("metadata.yaml" in note for note in reader.damage)
    assert any("without a footer" in note for note in reader.damage)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_repair_keeps_the_chunks_after_a_corrupt_one(tmp_path: Path, compression: str) -> None:
    with (tmp_path / "a.mcap").open("wb") as stream:
        kind = CompressionType.LZ4 if compression == "lz4" else CompressionType.ZSTD
        writer = Writer(stream, chunk_size=300, compression=kind)
        writer.start(profile="ros2")
        text = schema_text("std_msgs/msg/String").encode()
        channel = writer.register_channel("/a", "cdr", writer.register_schema("std_msgs/msg/String", "ros2msg", text))
        for i in range(9):
            writer.add_message(channel, i, serialize_message(String(data=str(i) * 400)), i)
        writer.flush()
    data, at, chunks = bytearray((tmp_path / "a.mcap").read_bytes()), 8, []
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        chunks += [at] if opcode == 6 else []
        at += 9 + length
    data[chunks[4] + 57 : chunks[4] + 65] = b"\xff" * 8
    (tmp_path / "a.mcap").write_bytes(data)
    repair_bag(tmp_path, [tmp_path / "a.mcap"])
    assert [m.log_time_ns for m in BagReader(tmp_path, allow_damaged=False).messages()] == [0, 1, 2, 3, 5, 6, 7, 8]
    with (tmp_path / "a.mcap").open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    for chunk in summary.chunk_indexes:  # its own index, not that of the corrupt chunk after it
        assert list(chunk.message_index_offsets.values()) == [chunk.chunk_start_offset + chunk.chunk_length]
    whole = (tmp_path / "a.mcap").read_bytes()
    finish_cut_file(tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == whole, "a complete file has no chunks to find"


def test_a_file_that_cannot_be_read_now_is_not_repaired(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "bag/bag_0.mcap"
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/a", String(data="kept"), 1)
    whole = file.read_bytes()

    def failing(*_: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("ltm_msgs_py.bag.mcap_index._chunk_at", failing)
    monkeypatch.setattr("ltm_msgs_py.bag.mcap_index._sound_summary", failing)
    with pytest.raises(RecordingError, match="cannot be read now"):
        repair_bag(tmp_path / "bag", [file])
    assert file.read_bytes() == whole


@pytest.mark.parametrize("kept", [0, 8, 9, 20])
def test_a_file_cut_in_its_header_keeps_the_bag(tmp_path: Path, kept: int) -> None:
    """After a power cut, the newest file may end anywhere, or hold zeros."""
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/a", String(data="one"), 1)
    (first,) = (tmp_path / "bag").glob("*.mcap")
    for number, end in enumerate((b"", bytes(30) if kept else b"")):
        (tmp_path / f"bag/x{number}.mcap").write_bytes(first.read_bytes()[:kept] + end)
    (tmp_path / "bag/metadata.yaml").unlink()
    repair_bag(tmp_path / "bag", sorted((tmp_path / "bag").glob("*.mcap")))
    assert [m.log_time_ns for m in BagReader(tmp_path / "bag", allow_damaged=False).messages()] == [1]


def test_a_bag_is_replaced_on_request_but_nothing_beside_it(tmp_path: Path) -> None:
    for name in ("alone", "notes", "folder"):
        with BagWriter(tmp_path / name) as writer:
            writer.write("/a", String(data="old"), 1)
    (tmp_path / "notes" / "notes.txt").write_text("kept")
    (tmp_path / "folder" / "kept.mcap").mkdir()
    BagWriter.require_free(tmp_path / "alone", overwrite=True)
    assert list((tmp_path / "alone").iterdir()) == []
    for name in ("notes", "folder"):
        with pytest.raises(RecordingError):
            BagWriter.require_free(tmp_path / name, overwrite=True)
        assert (tmp_path / name / "metadata.yaml").is_file()
