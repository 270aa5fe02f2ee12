import logging
import re
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import pytest
import yaml
import zstandard
from mcap.writer import CompressionType, Writer
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from std_msgs.msg import String

from ltm_core.base.errors import RecordingError
from ltm_msgs_py.bag.reader import BagMessage, BagReader
from ltm_msgs_py.bag.schemas import schema_text
from ltm_msgs_py.bag.writer import BagWriter

COUNT = 40


def text(i: int) -> str:
    return f"{i}:" + "x" * 400


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Two topics in chunks of a few messages; log times run 1000, 1010, ... with each fourth pair swapped."""
    times = [1000 + 10 * i for i in range(COUNT)]
    for i in range(3, COUNT, 4):
        times[i - 1], times[i] = times[i], times[i - 1]
    with BagWriter(tmp_path / "bag", compression=CompressionType.NONE, chunk_size=2500) as writer:
        writer.add_topic("/odd", "std_msgs/msg/String", latched=True)
        for i, time in enumerate(times):
            writer.write("/odd" if i % 2 else "/even", String(data=text(i)), time, time - 1)
    return tmp_path / "bag"


def chunk_spans(file: Path) -> list[tuple[int, int]]:
    """(offset, length) of each chunk record, read by the layout of the MCAP specification."""
    data, at, spans = file.read_bytes(), 8, []
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == 6:
            spans.append((at, 9 + length))
        at += 9 + length
    return spans


def messages_in(file: Path, chunk: tuple[int, int]) -> int:
    """How many message records an uncompressed chunk holds, by the same specification."""
    data, (start, length) = file.read_bytes(), chunk
    at, count = start + 9 + 40, 0  # times 8 + 8, size 8, crc 4, empty compression name 4, data length 8
    while at < start + length:
        opcode, size = struct.unpack_from("<BQ", data, at)
        count += opcode == 5
        at += 9 + size
    return count


def numbers(reader: BagReader, **query: Any) -> list[int]:
    return [int(reader.decode(m).data.partition(":")[0]) for m in reader.messages(**query)]


def test_topics_counts_qos_and_times(bag: Path) -> None:
    reader = BagReader(bag)
    assert reader.topics() == {"/odd": "std_msgs/msg/String", "/even": "std_msgs/msg/String"}
    infos = reader.topic_infos()
    assert (infos["/odd"].message_count, infos["/odd"].latched) == (COUNT // 2, True)
    assert (infos["/even"].message_count, infos["/even"].latched) == (COUNT // 2, False)
    assert (reader.start_ns, reader.end_ns, reader.damage) == (1000, 1000 + 10 * (COUNT - 1), ())


@pytest.mark.parametrize("bare", [False, True])
def test_messages_come_by_log_time(bag: Path, bare: bool) -> None:
    reader = BagReader(bag / "bag_0.mcap" if bare else bag)
    messages = list(reader.messages())
    assert [m.log_time_ns for m in messages] == [1000 + 10 * i for i in range(COUNT)]
    assert [m.publish_time_ns for m in messages] == [999 + 10 * i for i in range(COUNT)]
    assert sorted(numbers(reader)) == list(range(COUNT))
    assert reader.decode(messages[2]).data == text(3)  # logged first, written second


def test_topics_and_times_are_chosen(bag: Path) -> None:
    reader = BagReader(bag)
    assert all(n % 2 for n in numbers(reader, topics={"/odd"}))
    assert [m.log_time_ns for m in reader.messages(start_ns=1100, end_ns=1130)] == [1100, 1110, 1120]
    assert [m.log_time_ns for m in reader.messages(topics=["/odd"], start_ns=1100, end_ns=1130)] == [1100]
    assert list(reader.messages(topics=[])) == []
    assert list(reader.messages(topics=["/absent"])) == []
    assert list(reader.messages(start_ns=10_000)) == []


@pytest.mark.parametrize("cut", ["summary", "index", "chunk", "head"])
def test_a_file_cut_short_is_read_up_to_the_cut_which_is_named(
    bag: Path, cut: str, caplog: pytest.LogCaptureFixture
) -> None:
    file = bag / "bag_0.mcap"
    data, spans = file.read_bytes(), chunk_spans(file)
    start, length = spans[3]
    expected = sum(messages_in(file, span) for span in spans[: {"summary": len(spans), "index": 4}.get(cut, 3)])
    end = {"summary": len(data) - 20, "index": start + length + 3, "chunk": start + length // 2, "head": start + 4}[cut]
    file.write_bytes(data[:end])
    with caplog.at_level(logging.WARNING):
        reader = BagReader(bag)
    found = numbers(reader)
    assert expected > 0
    assert sorted(found) == list(range(expected))
    assert sum(info.message_count for info in reader.topic_infos().values()) == len(found)
    (note,) = reader.damage
    assert f"byte {end}" in note
    assert note in caplog.text
    assert reader.lost == ({"": 1} if cut == "chunk" else {})
    if cut == "chunk":
        assert f"the record at byte {start} should have {length - 9} bytes" in note
    with pytest.raises(RecordingError, match=f"byte {end}"):
        BagReader(bag, allow_damaged=False)


def write_mcap(path: Path, chunking: bool = True, encoding: str = "cdr", schema: str = "std_msgs/msg/String") -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=chunking, compression=CompressionType.LZ4)
        writer.start(profile="ros2")
        text = schema_text("std_msgs/msg/String").encode()
        channel = writer.register_channel("/a", encoding, writer.register_schema(schema, "ros2msg", text))
        for i in (2, 0, 1):
            writer.add_message(channel, i, serialize_message(String(data=str(i))), i)
        writer.finish()
    return path


@pytest.mark.parametrize("chunking", [True, False])
def test_files_of_another_writer_are_read(tmp_path: Path, chunking: bool) -> None:
    """lz4 chunks, or none at all (rosbag2's preset `fastwrite`)."""
    reader = BagReader(write_mcap(tmp_path / "a.mcap", chunking))
    assert numbers(reader) == [0, 1, 2]
    assert reader.damage == ()


def test_a_type_that_is_not_installed_is_named_when_it_is_decoded(tmp_path: Path) -> None:
    reader = BagReader(write_mcap(tmp_path / "a.mcap", schema="acme_msgs/msg/Rocket"))
    assert reader.topics() == {"/a": "acme_msgs/msg/Rocket"}
    with pytest.raises(RecordingError, match="acme_msgs/msg/Rocket is not installed"):
        reader.decode(next(reader.messages()))


@pytest.mark.parametrize("raw", [b"", b"\0\1", b"\xff" * 40, b"\0\1\0\0\xff\xff\xff\x7fabc"])
def test_bytes_that_do_not_decode_are_refused_with_topic_and_time(bag: Path, raw: bytes) -> None:
    reader = BagReader(bag)
    with pytest.raises(
        RecordingError, match=rf"/odd at 77 ns .*: {len(raw)} bytes do not decode as std_msgs/msg/String"
    ):
        reader.decode(BagMessage("/odd", 77, 77, "std_msgs/msg/String", raw))


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "is empty"),
        (b"SQLite format 3\0" + bytes(100), "SQLite bag"),
        (zstandard.FRAME_HEADER + b"\xff" * 50, "cannot read"),
        (zstandard.compress(zstandard.compress(b"\x89MCAP0\r\n")), "begins with 28 b5 2f fd"),
        (b"#ROSBAG V2.0\n", "ROS 1 bag"),
        (b"\xff\xd8\xff\xe0" + bytes(50), "begins with ff d8 ff e0"),
        (b"\x89MCA", "begins with 89 4d 43 41"),
    ],
)
def test_foreign_files_are_named(tmp_path: Path, content: bytes, complaint: str) -> None:
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(RecordingError, match=complaint):
        BagReader(tmp_path / "a.mcap")
    with pytest.raises(RecordingError, match=complaint):
        BagReader(tmp_path)


@pytest.mark.parametrize("storage", list(StoragePlugin))
@pytest.mark.parametrize("mode", [None, CompressionMode.FILE, CompressionMode.MESSAGE])
def test_bags_of_other_recorders_have_the_same_messages(
    bag: Path, tmp_path: Path, storage: StoragePlugin, mode: CompressionMode | None
) -> None:
    """SQLite, and bags compressed as a whole or message by message, as rosbag2 writes them."""
    ours = BagReader(bag)
    writer = Writer2(tmp_path / "other", version=9, storage_plugin=storage)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        store = get_typestore(Stores.ROS2_JAZZY)
        topics = {t: writer.add_connection(t, "std_msgs/msg/String", typestore=store) for t in ours.topics()}
        for message in ours.messages():
            writer.write(topics[message.topic], message.log_time_ns, message.raw)
    theirs = BagReader(tmp_path / "other", allow_damaged=False)
    assert theirs.topics() == ours.topics()
    assert (theirs.start_ns, theirs.end_ns) == (ours.start_ns, ours.end_ns)
    assert [theirs.topic_infos()[t].message_count for t in ours.topics()] == [COUNT // 2] * 2
    for query in ({}, {"topics": ["/odd"], "start_ns": 1100, "end_ns": 1200}):
        assert numbers(theirs, **query) == numbers(ours, **query)
    (file,) = (f for f in (tmp_path / "other").iterdir() if f.suffix != ".yaml")
    assert numbers(BagReader(file)) == numbers(ours)


def test_a_corrupt_sqlite_bag_is_read_up_to_the_fault(bag: Path, tmp_path: Path) -> None:
    ours, store = BagReader(bag), get_typestore(Stores.ROS2_JAZZY)
    with Writer2(tmp_path / "other", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection("/odd", "std_msgs/msg/String", typestore=store)
        for message in [*ours.messages()] * 10:
            writer.write(topic, message.log_time_ns, message.raw)
    file = tmp_path / "other/other.db3"
    data = bytearray(file.read_bytes())
    data[len(data) // 2 :] = bytes(len(data) - len(data) // 2)
    file.write_bytes(data)
    try:
        reader = BagReader(file)
    except RecordingError:
        return
    read = list(reader.messages())
    assert len(read) < 10 * COUNT
    assert reader.damage
    assert reader.lost.total() > 0


def test_a_message_that_states_a_huge_size_is_not_unpacked(bag: Path, tmp_path: Path) -> None:
    (first, *_), store = [*BagReader(bag).messages()], get_typestore(Stores.ROS2_JAZZY)
    huge = struct.pack("<IBQ", 0xFD2FB528, 0xE0, 1 << 45) + zstandard.compress(first.raw)[8:]
    with Writer2(tmp_path / "other", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection("/odd", "std_msgs/msg/String", typestore=store)
        for raw in (zstandard.compress(first.raw), huge):
            writer.write(topic, first.log_time_ns, raw)
    assert [message.raw for message in BagReader(tmp_path / "other").messages()] == [first.raw, huge]


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"relative_file_paths": ["absent.mcap"]}, r"'absent\.mcap', which does not exist in"),
        ({"relative_file_paths": ["../bag/bag_0.mcap"]}, "which does not exist in"),
        ({"relative_file_paths": None}, "relative_file_paths"),
        ({"relative_file_paths": [3]}, "relative_file_paths"),
    ],
)
def test_metadata_that_does_not_fit_is_refused(bag: Path, change: dict[str, object], complaint: str) -> None:
    path = bag / "metadata.yaml"
    document = yaml.safe_load(path.read_text())
    document["rosbag2_bagfile_information"].update(change)
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(RecordingError, match=complaint):
        BagReader(bag)


def repacked(bag: Path, inner: bytes, stated: int | None = None) -> Path:
    """A file whose first chunk holds `inner`, and which ends after it; `stated`: what its zstd frame says it holds."""
    file = next(bag.glob("*.mcap"))
    data = file.read_bytes()
    begin = next(at for at, _ in chunk_spans(file))
    packed = zstandard.compress(inner)
    if stated is not None:
        packed = struct.pack("<IBQ", 0xFD2FB528, 0xE0, stated) + packed[8:]
    body = struct.pack("<QQQII", 0, 1, len(inner), 0, 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    made = bag.parent / "made.mcap"
    made.write_bytes(data[:begin] + struct.pack("<BQ", 6, len(body)) + body)
    return made


@pytest.mark.parametrize(
    ("inner", "stated", "complaint"),
    [
        (bytes(140 << 20), None, "chunk states a size of 146800640 bytes"),
        (bytes(9), 1 << 45, "chunk states a size of 35184372088832 bytes"),
        (bytes(60 << 20), None, "record 1 of the chunk has opcode 0"),
        ((struct.pack("<BQ", 5, 22) + bytes(22)) * 500_000, None, r"record \d+ of the chunk .* at most \d+ records"),
    ],
)
def test_a_chunk_that_unfolds_to_gigabytes_is_left_out(
    bag: Path, inner: bytes, stated: int | None, complaint: str
) -> None:
    """98 kilobytes of these took 40 seconds and 3.3 gigabytes."""
    file = repacked(bag, inner, stated)
    assert file.stat().st_size < 200_000
    tracemalloc.start()
    reader = BagReader(file)
    assert list(reader.messages()) == []
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert any(re.search(complaint, note) for note in reader.damage), reader.damage
    assert peak < 200 << 20


@pytest.mark.parametrize("chunk_size", [1, 1 << 20, None], ids=["a chunk each", "one chunk", "no chunks"])
@pytest.mark.parametrize(("log_time", "sent"), [(2**64 - 1, 30), (2**63, 30), (30, 2**63)])
def test_messages_of_no_time_are_left_out(tmp_path: Path, chunk_size: int | None, log_time: int, sent: int) -> None:
    """MCAP's times go to the year 2554; one beyond ROS's ended a whole archive's run."""
    path = tmp_path / "late.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=chunk_size is not None, chunk_size=chunk_size or 1)
        writer.start("ros2", "test")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", schema_text("std_msgs/msg/String").encode())
        channel = writer.register_channel("/text", "cdr", schema)
        for time, published in ((10, 10), (log_time, sent), (20, 2**63 - 1)):
            writer.add_message(channel, time, bytes(serialize_message(String(data="x"))), published)
        writer.finish()
    reader = BagReader(path)
    assert [message.log_time_ns for message in reader.messages()] == [10, 20]
    assert [message.log_time_ns for message in reader.messages()] == [10, 20]
    (note,) = reader.damage
    assert f"1 messages have times up to {max(log_time, sent)} ns, later than {2**63 - 1} ns, and are ignored" in note
    assert reader.end_ns <= 2**63 - 1


@pytest.mark.parametrize(
    ("place", "value"),
    [(28 + 4, b"none"), (16, struct.pack("<Q", 1 << 40)), (-30, b"\xff" * 8)],
    ids=["unknown compression", "impossible size", "corrupt data"],
)
def test_two_damaged_chunks_lose_their_messages_alone(tmp_path: Path, place: int, value: bytes) -> None:
    with BagWriter(tmp_path / "bag", chunk_size=2500) as writer:
        for i in range(COUNT):
            writer.write("/a", String(data=text(i * 7919)), 1000 + i)
    file = tmp_path / "bag" / "bag_0.mcap"
    data, chunks = bytearray(file.read_bytes()), chunk_spans(file)
    for start, length in chunks[1:3]:
        at = start + (9 + place if place > 0 else length + place)
        data[at : at + len(value)] = value
    file.write_bytes(data)
    reader = BagReader(file)
    found = len(list(reader.messages()))
    assert 0 < found < COUNT
    assert reader.lost == {"/a": COUNT - found}
    assert len(reader.damage) == 2
