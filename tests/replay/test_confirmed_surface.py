from pathlib import Path
from typing import Any

import numpy as np
from scenes.small_site import BEGIN_NS, NAME, SmallSite
from scenes.terrain_frames import HOUR, built_up, mast_pose, photo_of_depth, write_fusing_site
from sensor_msgs.msg import NavSatFix

from ltm_core.tracing import TerrainTracer
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.cells import msg_to_version
from ltm_msgs_py.image import image_to_msg, msg_to_depth
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.recordings.replay.offline import OfflineGraph
from ltm_ros.runtime.topics import DEPTH_IMAGE, DEPTH_INFO, FUSED_DEPTH, IMAGE_RAW, camera_topic

STAMPS = [BEGIN_NS + look * 2 * HOUR for look in range(5)]
NODES = ("terrain", *(f"mast/{kind}" for kind in ("capture", "depth", "segmentation", "topodepth")))


def replayed(small: SmallSite, state: Path) -> tuple[Path, dict[str, dict[str, str]]]:
    """The mast's photos of a block that stands in its view since, through the offline graph, with a state of its own;
    the bag of the results and the nodes' summaries."""
    whole = describe(small.site, small.path, parameters={"terrain": {"folder": str(state)}})
    writer = BagWriter(state.with_name(f"{state.name}_bag"))
    graph = OfflineGraph(Graph(NAME, tuple(whole.node(label) for label in NODES)), writer)
    photo = photo_of_depth(built_up(small), small.site.camera("mast").calibration.camera(), mast_pose(small))
    for stamp in STAMPS:
        graph.feed(camera_topic(NAME, "mast", IMAGE_RAW), image_to_msg(photo, "rgb8", stamp, "mast_optical"), stamp)
    graph.finish()
    writer.close()
    return state.with_name(f"{state.name}_bag"), {name: health.summary() for name, health in graph.healths.items()}


def comparable(message: Any) -> Any:
    """The altitude of a fix is NaN, which equals nothing."""
    return str(message) if isinstance(message, NavSatFix) else message


def content(bag: Path) -> list[tuple[str, int, Any]]:
    """Every message of a bag: topic, time, what it says."""
    reader = BagReader(bag)
    return [(message.topic, message.log_time_ns, comparable(reader.decode(message))) for message in reader.messages()]


def test_a_replay_goes_over_to_the_confirmed_surface_and_repeats_to_the_bit(tmp_path: Path) -> None:
    (tmp_path / "site").mkdir()
    terrain = {"trace_confirmed": True}
    small = write_fusing_site(tmp_path / "site", False, terrain=terrain)
    bag, summaries = replayed(small, tmp_path / "first")
    again, _ = replayed(small, tmp_path / "again")
    assert content(bag) == content(again)
    first, second = ((folder / "surfaces").iterdir() for folder in (tmp_path / "first", tmp_path / "again"))
    assert {path.name: path.read_bytes() for path in first} == {path.name: path.read_bytes() for path in second}
    reader = BagReader(bag)

    def of(topic: Any) -> list[Any]:
        return [reader.decode(message) for message in reader.messages([camera_topic(NAME, "mast", topic)])]

    traced = {stamp_of(message): msg_to_version(message) for message in of(DEPTH_INFO)}
    assert list(traced) == STAMPS
    switched = [bool(version) for version in traced.values()]
    assert switched == sorted(switched), "once confirmed, it stays so"
    assert switched[:2] == [False, False]
    assert switched[-1]
    camera, pose = small.site.camera("mast").calibration.camera(), mast_pose(small)
    was, now = (TerrainTracer(dem).trace(camera, pose).depth() for dem in (small.dem, built_up(small)))
    known = np.isfinite(was) & np.isfinite(now)
    block = known & (np.abs(np.where(known, was, 0) - np.where(known, now, 0)) > 5.0)

    def error(topic: Any, stamp: int) -> float:
        depth = next(msg_to_depth(m) for m in of(topic) if stamp_of(m) == stamp)
        seen = block & np.isfinite(depth)
        return float(np.median(np.abs(depth[seen] - now[seen])))

    assert error(DEPTH_IMAGE, STAMPS[-1]) < 0.5 * error(DEPTH_IMAGE, STAMPS[0])
    assert error(FUSED_DEPTH, STAMPS[-1]) < 0.5 * error(DEPTH_IMAGE, STAMPS[0])
    assert {one.get("dropped", "0") for one in summaries.values()} == {"0"}
