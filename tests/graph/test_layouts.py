"""A site's graph with its cameras' nodes in one process gives what the replay without DDS gives."""

from pathlib import Path
from typing import Any

import pytest
from scenes.small_site import FRAMES, NAME
from scenes.terrain_frames import write_fusing_site

from ltm_core.pipeline.stored_fuel import STORE_FILE, STORE_KIND
from ltm_core.storage.tile_store import TileStore
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.archive.reduction import store_digest
from ltm_ros.launching.graph import CAMERA_NODES, FUSION_NODES
from ltm_ros.recordings.replay.run import ReplayOptions, run_live, run_offline
from ltm_ros.runtime.topics import DEPTH_IMAGE, FUEL_VOTES, FUSED_DEPTH, LABELS_IMAGE, POSED_POSE, camera_topic

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("kernels")]

CAMERAS = ("tower", "mast")
RESULTS = (POSED_POSE, DEPTH_IMAGE, LABELS_IMAGE, FUSED_DEPTH, FUEL_VOTES)


@pytest.fixture(scope="module")
def offline(kernels: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the replay without DDS leaves: a recording and the map."""
    folder = tmp_path_factory.mktemp("offline")
    small = write_fusing_site(folder)
    options = ReplayOptions(export=folder / "map.tif", record=folder / "results", state=folder / "state")
    options.state.mkdir()
    run_offline(small.bag, small.path, options, lambda done, total: None)
    return folder


def test_a_live_replay_gives_the_bytes_of_the_offline_one(offline: Path, ros_domain: int, tmp_path: Path) -> None:
    small = write_fusing_site(tmp_path)
    assert small.bag.joinpath("metadata.yaml").is_file()
    state = tmp_path / "state"
    state.mkdir()
    options = ReplayOptions(
        export=tmp_path / "map.tif", record=tmp_path / "results", state=state, rate=0.25, domain_id=ros_domain
    )
    lines: list[str] = []
    summaries = run_live(small.bag, small.path, options, lambda done, total: None, lines.append)
    for camera in CAMERAS:
        for node in (*CAMERA_NODES, *FUSION_NODES):
            summary = summaries[f"/{NAME}/{camera}/{node}"]
            counts = [summary[key] for key in ("frames_in", "frames_out", "dropped")]
            assert counts == [str(FRAMES), str(FRAMES), "0"], summary
    assert (tmp_path / "map.tif").read_bytes() == (offline / "map.tif").read_bytes()
    assert digest_of(state) == digest_of(offline / "state")
    live, expected = (BagReader(folder / "results") for folder in (tmp_path, offline))
    for camera in CAMERAS:
        for topic in RESULTS:
            name = camera_topic(NAME, camera, topic)
            messages, wanted = (content_of(bag, name) for bag in (live, expected))
            assert len(wanted) == FRAMES
            assert messages == wanted, name


def digest_of(state: Path) -> str:
    """Of all that the fuel map keeps."""
    with TileStore.open_read_only(state / STORE_FILE, STORE_KIND) as store:
        return store_digest(store)


def content_of(bag: BagReader, topic: str) -> dict[int, tuple[Any, ...]]:
    """By stamp, all that the messages of a topic say; images bit by bit, for NaN is not NaN."""
    messages = [bag.decode(message) for message in bag.messages([topic])]
    return {stamp_of(m): tuple(plain(getattr(m, name)) for name in m.get_fields_and_field_types()) for m in messages}


def plain(value: Any) -> Any:
    return bytes(value) if hasattr(value, "tobytes") else str(value)
