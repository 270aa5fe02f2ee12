import json
import shutil
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PoseStamped
from mcap.writer import CompressionType, Writer
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from scenes.small_site import FRAMES, NAME, SmallSite
from std_msgs.msg import String
from typer.testing import CliRunner, Result

from ltm_core.base.errors import LtmError
from ltm_msgs_py.bag.reader import BagMessage, BagReader
from ltm_msgs_py.bag.schemas import schema_text
from ltm_msgs_py.image import compressed_to_rgb, image_to_msg
from ltm_msgs_py.stamp import ns_to_time, stamp_of
from ltm_ros.cli.main import cli

IMAGE, INFO, POSE = "image_raw/compressed", "camera_info", "pose"
DAY = 86_400 * 10**9
Row = tuple[str, str, bytes, int, str]
"""Topic below the tower's name (or absolute), type, bytes, log time, encoding."""
Change = Callable[[str, int, Any, BagMessage], list[Row]]
"""Makes rows of a message: of its topic, its number there, its content."""


@pytest.fixture(scope="module")
def tower(small_site: SmallSite, tmp_path_factory: pytest.TempPathFactory) -> SmallSite:
    """The small site with its tower alone."""
    folder = tmp_path_factory.mktemp("tower") / "site"
    shutil.copytree(small_site.folder, folder)
    document = yaml.safe_load((folder / "site.yaml").read_text())
    document["cameras"] = {"tower": {}}
    (folder / "site.yaml").write_text(yaml.safe_dump(document))
    return SmallSite(folder)


def of(message: BagMessage, **changes: Any) -> list[Row]:
    given = {"topic": message.topic.partition("/tower/")[2], "type": message.type_name, "raw": message.raw}
    whole = {**given, "time": message.log_time_ns, "encoding": "cdr", **changes}
    return [(whole["topic"], whole["type"], whole["raw"], whole["time"], whole["encoding"])]


def rows_of(site: SmallSite, change: Change) -> Iterator[Row]:
    reader, numbers = BagReader(site.bag), dict[str, int]()
    for message in reader.messages():
        if "/tower/" not in message.topic:
            continue
        number = numbers[message.topic] = numbers.get(message.topic, -1) + 1
        yield from change(message.topic.partition("/tower/")[2], number, reader.decode(message), message)


def made(site: SmallSite, path: Path, change: Change = lambda _, n, content, message: of(message)) -> Path:
    """A recording of the tower as another writer makes it: a chunk for each frame."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=1 << 30, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        channels: dict[tuple[str, str, str], int] = {}
        for number, (topic, kind, raw, time, encoding) in enumerate(rows_of(site, change), start=1):
            name = topic if topic.startswith("/") else f"/{NAME}/tower/{topic}"
            if (name, kind, encoding) not in channels:
                schema = writer.register_schema(kind, "ros2msg", schema_text(kind).encode())
                channels[name, kind, encoding] = writer.register_channel(name, encoding, schema)
            writer.add_message(channels[name, kind, encoding], time, raw, time)
            if number % 3 == 0:
                writer.flush()
        writer.finish()
    return path


def replayed(site: Path, bag: Path, out: Path) -> tuple[Result, int]:
    """The result of the command, and the number of frames in its fuel map."""
    command = ["replay", str(bag), "--site", str(site), "--out", str(out), "--offline"]
    result = CliRunner().invoke(cli, command, env={"COLUMNS": "400"})
    assert result.exception is None or isinstance(result.exception, LtmError | SystemExit), result.exc_info
    votes = [line.split("│")[3] for line in result.output.splitlines() if "tower/fuel_votes" in line and "│" in line]
    return result, int(votes[0]) if votes else 0


def reprocessed(site: Path, bag: Path, out: Path, *options: str) -> tuple[Result, dict[str, Any]]:
    command = ["reprocess", str(bag), "--site", str(site), "--out", str(out), "--workers", "0", *options]
    result = CliRunner().invoke(cli, command)
    assert result.exception is None or isinstance(result.exception, LtmError | SystemExit), result.exc_info
    return result, json.loads((out / "run.json").read_text())


def posed(kind: Any, frame: str = "") -> Change:
    def change(topic: str, number: int, content: Any, message: BagMessage) -> list[Row]:
        if topic != POSE:
            return of(message)
        given = kind(header=content.header)
        given.pose = content.pose.pose if kind is PoseStamped else content.pose
        if frame:
            given.child_frame_id = frame
        module = "geometry_msgs" if kind is PoseStamped else "nav_msgs"
        return of(message, type=f"{module}/msg/{kind.__name__}", raw=serialize_message(given))

    return change


def raw_images(encoding: str, both: bool = False) -> Change:
    def change(topic: str, number: int, content: Any, message: BagMessage) -> list[Row]:
        if topic != IMAGE:
            return of(message)
        rgb, stamp = compressed_to_rgb(content), stamp_of(content)
        pixels = {
            "bgra8": lambda: np.dstack([rgb[..., ::-1], np.full(rgb.shape[:2], 255, np.uint8)]),
            "16UC1": lambda: rgb[..., 0].astype(np.uint16),
        }.get(encoding, lambda: rgb)()
        image = image_to_msg(pixels, encoding.partition(" ")[0], stamp, "c")
        image.step = 7 if "step" in encoding else image.step
        raw = of(message, topic="image_raw", type="sensor_msgs/msg/Image", raw=serialize_message(image))
        return [*of(message), *raw] if both else raw

    return change


def only(which: str, **changes: Any) -> Change:
    """Changes messages of a topic, `{number}` of them if `at` is given."""
    at = changes.pop("at", None)
    return lambda topic, n, content, message: of(message, **(changes if topic == which and at in (None, n) else {}))


def restamped(to: Callable[[int], int]) -> Change:
    def change(topic: str, number: int, content: Any, message: BagMessage) -> list[Row]:
        content.header.stamp = ns_to_time(to(stamp_of(content)))
        return of(message, raw=serialize_message(content))

    return change


def uncalibrated(topic: str, number: int, content: Any, message: BagMessage) -> list[Row]:
    if topic != INFO:
        return of(message)
    content.k = np.zeros(9)
    return of(message, raw=serialize_message(content))


TEXT = {"type": "std_msgs/msg/String", "raw": serialize_message(String(data="north"))}


@pytest.mark.parametrize(
    ("change", "frames", "code"),
    [
        (posed(PoseStamped), FRAMES, 0),
        (posed(Odometry, "tower_optical"), FRAMES, 0),
        (posed(Odometry, "base_link"), 0, 1),
        (raw_images("rgb8"), FRAMES, 0),
        (raw_images("bgra8"), FRAMES, 0),
        (raw_images("rgb8", both=True), FRAMES, 0),
        (raw_images("16UC1"), FRAMES, 1),
        (raw_images("rgb8 step"), 0, 1),
        (only(INFO, **TEXT), 0, 1),
        (only(INFO, at=2, **TEXT), FRAMES, 1),
        (only(POSE, **TEXT), 0, 1),
        (only(IMAGE, **TEXT), 0, 1),
        (only(POSE, topic="fix", **TEXT), 0, 1),
        (only(POSE, encoding="json"), 0, 1),
        (only(POSE, at=2, raw=b""), FRAMES - 1, 1),
        (only(IMAGE, at=2, raw=b"\0\1"), FRAMES - 1, 1),
        (only(POSE, topic="/odom"), 0, 1),
        (restamped(lambda stamp: 0), 0, 1),
        (restamped(lambda stamp: stamp + 5 * DAY), FRAMES, 1),
        (uncalibrated, 0, 1),
    ],
    ids=[
        *("PoseStamped", "Odometry", "Odometry of another frame", "raw", "bgra8", "both kinds", "16UC1", "wrong step"),
        *("all camera_info String", "one camera_info String", "pose String", "image String", "no pose", "json"),
        *("empty pose", "short image", "pose elsewhere", "stamps of zero", "stamps in the future", "uncalibrated"),
    ],
)
def test_a_replay_takes_what_it_can_and_says_whether_it_was_all(
    tower: SmallSite, tmp_path: Path, change: Change, frames: int, code: int
) -> None:
    bag = made(tower, tmp_path / "case.mcap", change)
    result, found = replayed(tower.path, bag, tmp_path / "out")
    assert (result.exit_code, found) == (code, frames), f"{result.output} {result.exception}"
    if not frames and "no frame was finished" in str(result.exception):
        kinds = BagReader(bag).topics()
        assert all(f"{name} ({kind})" in str(result.exception) for name, kind in kinds.items())


@pytest.mark.parametrize(
    "change", [posed(PoseStamped), posed(Odometry, "tower_optical"), raw_images("rgb8", both=True)]
)
def test_an_archive_takes_the_same(tower: SmallSite, tmp_path: Path, change: Change) -> None:
    result, record = reprocessed(tower.path, made(tower, tmp_path / "case.mcap", change), tmp_path / "out")
    assert (result.exit_code, record["frames"]["merged"], record["frames"]["failed"]) == (0, FRAMES, 0)


def damaged(bag: Path, chunks: list[int], cut: bool = False) -> Path:
    """With a byte flipped in these chunks; `cut`: without what follows the middle of the last of them."""
    data, at, found = bytearray(bag.read_bytes()), 8, []
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        found += [(at, 9 + length)] if opcode == 6 else []
        at += 9 + length
    places = [start + length // 2 for start, length in (found[i] for i in chunks)]
    for place in places:
        data[place] ^= 0x10
    bag.write_bytes(data[: places[-1]] if cut else data)
    return bag


@pytest.mark.parametrize(
    ("chunks", "cut", "lost"),
    [([1], False, 1), ([1, 4], False, 2), ([5], True, 1), ([*range(FRAMES)], False, FRAMES)],
    ids=["one", "two", "cut", "all"],
)
def test_damage_counts_as_lost_frames(
    tower: SmallSite, tmp_path: Path, chunks: list[int], cut: bool, lost: int
) -> None:
    bag = damaged(made(tower, tmp_path / "case.mcap"), chunks, cut)
    result, frames = replayed(tower.path, bag, tmp_path / "out")
    assert (result.exit_code, frames) == (1, FRAMES - lost)
    assert cut or f"1 of /{NAME}/tower/{IMAGE}" in str(result.exception)
    refused, record = reprocessed(tower.path, bag, tmp_path / "strict")
    assert (refused.exit_code, record["frames"]["failed"], record["failures"][0]["cause"]) == (1, lost, "damage")
    allowed, record = reprocessed(tower.path, bag, tmp_path / "mild", "--max-failed", "60%")
    assert (allowed.exit_code, record["frames"]["merged"]) == (lost == FRAMES, FRAMES - lost)


def test_topics_that_the_site_file_names_are_taken(tower: SmallSite, tmp_path: Path) -> None:
    names = {IMAGE: "/rig/cam/image_raw/compressed", INFO: "/rig/cam/camera_info", POSE: "/odom"}
    bag = made(tower, tmp_path / "case.mcap", lambda topic, n, content, message: of(message, topic=names[topic]))
    refused, _ = replayed(tower.path, bag, tmp_path / "refused")
    assert refused.exit_code == 1
    proposed = str(refused.exception).partition("in the site file: ")[2]
    document = yaml.safe_load(tower.path.read_text()) | {"cameras": yaml.safe_load(f"{{{proposed}}}")}
    own = tower.folder / "mapped.yaml"
    own.write_text(yaml.safe_dump(document))
    result, frames = replayed(own, bag, tmp_path / "out")
    assert (result.exit_code, frames) == (0, FRAMES)
    _, record = reprocessed(own, bag, tmp_path / "archive")
    assert record["frames"]["merged"] == FRAMES
