import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from scenes.networks import write_classifier, write_swapping_head
from scenes.small_site import BUILT, FRAMES, GRASS, NAME, SmallSite
from sensor_msgs.msg import NavSatFix
from typer.testing import CliRunner

from ltm_core.geometry.pose import Pose
from ltm_msgs_py.bag.cdr import TF_TYPE
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import compressed_to_msg, encode_rgb, msg_to_array, msg_to_depth
from ltm_msgs_py.json_topics import msg_to_model
from ltm_msgs_py.pose import msg_to_transform
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.cli.main import cli
from ltm_ros.recordings.replay.run import ReplayOptions, run_offline
from ltm_ros.runtime.topics import (
    DEPTH_CAMERA_INFO,
    DEPTH_IMAGE,
    FUEL_VOTES,
    IMAGE_COMPRESSED,
    LABELS_IMAGE,
    LABELS_INFO,
    POSED_POSE,
    camera_topic,
)

Summaries = dict[str, dict[str, str]]


def replayed(small: SmallSite, out: Path, bag: Path | None = None, **options: Any) -> Summaries:
    """Offline replay into `out`/map.tif and `out`/bag."""
    out.mkdir()
    wanted = ReplayOptions(export=out / "map.tif", record=out / "bag", **options)
    return run_offline(bag or small.bag, small.path, wanted, lambda done, total: None)


def comparable(message: Any) -> Any:
    """The altitude of a fix is NaN, which equals nothing."""
    return str(message) if isinstance(message, NavSatFix) else message


def messages_of(bag: Path) -> list[tuple[str, int, Any]]:
    reader = BagReader(bag, allow_damaged=False)
    return [(m.topic, m.log_time_ns, comparable(reader.decode(m))) for m in reader.messages()]


@pytest.fixture(scope="module")
def first(small_site: SmallSite, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Summaries]:
    """A replay of the whole recording."""
    out = tmp_path_factory.mktemp("replayed") / "out"
    return out, replayed(small_site, out)


def test_twice_gives_the_same_bytes(small_site: SmallSite, first: tuple[Path, Summaries], tmp_path: Path) -> None:
    (once, summaries), again = first, replayed(small_site, tmp_path / "again")
    assert (tmp_path / "again/map.tif").read_bytes() == (once / "map.tif").read_bytes()
    assert messages_of(tmp_path / "again/bag") == messages_of(once / "bag")
    assert summaries.keys() == again.keys()


def test_every_frame_id_leads_to_the_map_by_the_recordings_own_transforms(
    small_site: SmallSite, first: tuple[Path, Summaries]
) -> None:
    """As another reader finds it; and the chain is each frame's pose."""
    frames, parents, poses = set(), dict[str, str](), dict[tuple[str, int], Pose]()
    with AnyReader([first[0] / "bag"]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            if connection.msgtype != TF_TYPE:
                frames |= {message.header.frame_id} if hasattr(message, "header") else set()
                continue
            for one in message.transforms:
                parents[one.child_frame_id] = one.header.frame_id
                stamp = one.header.stamp.sec * 10**9 + one.header.stamp.nanosec
                poses[one.child_frame_id, stamp] = msg_to_transform(one)
    assert frames == {"map", "tower_optical", "mast_optical"}
    for frame in frames - {"map"}:
        assert parents[parents[frame]] == "map"
    for frame in small_site.frames():
        link = poses[f"{frame.camera_name}_link", frame.stamp_ns]
        seen = poses[f"{frame.camera_name}_optical", 0].after(link)
        np.testing.assert_allclose(seen.position, frame.pose.position)
        np.testing.assert_allclose(seen.rotation, frame.pose.rotation, atol=1e-12)


def test_every_frame_comes_out_with_its_stamp(small_site: SmallSite, first: tuple[Path, Summaries]) -> None:
    out, summaries = first
    assert {name: s["dropped"] for name, s in summaries.items()} == dict.fromkeys(summaries, "0")
    assert summaries[f"/{NAME}/fuel_map"]["frames"] == str(2 * FRAMES)
    reader = BagReader(out / "bag", allow_damaged=False)
    for camera in ("tower", "mast"):
        frames = [f for f in small_site.frames() if f.camera_name == camera]
        for topic in (POSED_POSE, DEPTH_IMAGE, DEPTH_CAMERA_INFO, LABELS_IMAGE, FUEL_VOTES):
            messages = [reader.decode(m) for m in reader.messages([camera_topic(NAME, camera, topic)])]
            assert [stamp_of(m) for m in messages] == [f.stamp_ns for f in frames], (camera, topic)
            if topic == DEPTH_IMAGE:
                for frame, message in zip(frames, messages, strict=True):
                    expected = small_site.tracer.trace(frame.camera, frame.pose).depth()
                    np.testing.assert_allclose(msg_to_depth(message), expected, rtol=1e-6)


def test_a_dropped_image_is_named_by_camera_stamp_and_recording(small_site: SmallSite, tmp_path: Path) -> None:
    topic, seen = camera_topic(NAME, "tower", IMAGE_COMPRESSED), 0
    with BagWriter(tmp_path / "odd") as bag:
        for message in BagReader(small_site.bag).messages():
            raw = message.raw
            if message.topic == topic:
                seen += 1
                if seen == 2:
                    stamp = stamp_of(BagReader(small_site.bag).decode(message))
                    portrait = encode_rgb(np.zeros((320, 180, 3), np.uint8))
                    raw = serialize_message(compressed_to_msg(portrait, "jpeg", stamp, "tower_optical"))
            bag.write_raw(message.topic, message.type_name, raw, message.log_time_ns)
    command = ["replay", str(tmp_path / "odd"), "--site", str(small_site.path), "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(cli, [*command, "--offline"], env={"COLUMNS": "1000"})
    assert result.exit_code == 0, result.output
    said = next(line for line in result.output.splitlines() if line.startswith("tower/capture dropped by image"))
    assert "image of tower is 180 x 320 pixels, but its calibration is for 320 x 180" in said
    assert f"/{NAME}/tower/" in said
    assert f"stamp 2023-11-14T22:13:20.250Z ({stamp} ns), {tmp_path / 'odd'}" in said


def test_command_line(small_site: SmallSite, first: tuple[Path, Summaries], tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = ["replay", str(small_site.bag), "--site", str(small_site.path), "--out", str(out), "--offline"]
    result = CliRunner().invoke(cli, [*command, "--record"])
    assert result.exit_code == 0, result.output
    assert "tower/capture" in result.output
    assert (out / "fuel_map.tif").read_bytes() == (first[0] / "map.tif").read_bytes()
    assert messages_of(out / "bag")
    for wrong in (["--loop"], ["--rate", "2"], ["--rrd"], ["--publish-only"]):
        refused = CliRunner().invoke(cli, [*command, *wrong])
        assert refused.exit_code != 0, wrong


def test_a_camera_s_head_reaches_its_labels_and_no_other_camera_s(
    small_site: SmallSite, first: tuple[Path, Summaries], tmp_path: Path
) -> None:
    shutil.copytree(small_site.folder, tmp_path / "taught")
    taught = SmallSite(tmp_path / "taught")
    write_swapping_head(taught.folder / "heads" / "swap.yaml", write_classifier(taught.folder, maps=True))
    site = yaml.safe_load(taught.path.read_text())
    site["expert"] = {"label_heads": "heads"}
    site["cameras"]["mast"]["label_head"] = "swap"
    taught.path.write_text(yaml.safe_dump(site))
    replayed(taught, tmp_path / "headed")
    before, after = (
        {(t, stamp_of(m)): msg_to_array(m, ("mono8",)) for t, _, m in messages_of(bag) if t.endswith(LABELS_IMAGE.name)}
        for bag in (first[0] / "bag", tmp_path / "headed/bag")
    )
    assert len(before) == len(after) == 2 * FRAMES
    swap = np.arange(256, dtype=np.uint8)
    swap[[GRASS, BUILT]] = BUILT, GRASS
    for (topic, stamp), labels in before.items():
        expected = swap[labels] if "/mast/" in topic else labels
        assert (after[topic, stamp] == expected).mean() > 0.97, topic
        assert "/mast/" in topic or np.array_equal(after[topic, stamp], labels)
    told = {t: msg_to_model(m) for t, _, m in messages_of(tmp_path / "headed" / "bag") if t.endswith(LABELS_INFO.name)}
    assert ", label head swap " in told[camera_topic(NAME, "mast", LABELS_INFO)]
    assert "head" not in told[camera_topic(NAME, "tower", LABELS_INFO)]
