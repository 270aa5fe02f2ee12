import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes.outlets import Kept
from scenes.small_site import BEGIN_NS, NAME, SmallSite
from scenes.terrain_frames import HOUR, measured_messages, sunk, write_terrain_site

from ltm_core.base.errors import MessageError, StoreError
from ltm_core.raster.dem import Dem
from ltm_core.surface.surface_versions_io import FOLDER, MANIFEST, SurfaceVersions
from ltm_core.tracing import TerrainTracer
from ltm_msgs_py.cells import msg_to_version
from ltm_msgs_py.image import msg_to_depth
from ltm_msgs_py.pose import msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_msgs_py.status import msg_to_values, status_to_msg
from ltm_ros.launching.graph import describe
from ltm_ros.nodes.depth import DepthConfig, DepthHandler
from ltm_ros.nodes.terrain import TerrainHandler, TerrainNodeConfig
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import (
    DEPTH_IMAGE,
    DEPTH_INFO,
    POSED_CAMERA_INFO,
    POSED_POSE,
    TERRAIN_SURFACE,
    TERRAIN_UPDATE,
    camera_topic,
    site_topic,
)

SURFACE = site_topic(NAME, TERRAIN_SURFACE)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> SmallSite:
    terrain = {"trace_confirmed": True}
    nodes = {"terrain": {"max_behind": 1e9, "folder": "kept", "depth_from_elsewhere": True}}
    return write_terrain_site(tmp_path_factory.mktemp("site"), False, terrain=terrain, nodes=nodes)


class Chain:
    """A terrain node and a depth node of the mast, as the graph configures them, with a state of their own."""

    def __init__(self, small: SmallSite, state: Path) -> None:
        self.small, self.state = small, state
        self.start()

    def restart(self) -> None:
        """Both nodes on what was on the disk, as after a kill of both."""
        killed = self.state
        self.state = killed.with_name(f"{killed.name}_again")
        shutil.copytree(killed, self.state)
        self.start()

    def start(self) -> None:
        self.folder = self.state / FOLDER
        parameters = {"terrain": {"folder": str(self.state)}}
        self.graph = describe(self.small.site, self.small.path, parameters=parameters)
        self.told, self.traced = Kept(), Kept()
        self.health, self.depth_health = Health(), Health()
        self.terrain = TerrainHandler(TerrainNodeConfig.model_validate(self._given("terrain")), self.told, self.health)
        self.terrain.start()
        self.depth = DepthHandler(DepthConfig.model_validate(self._given("mast/depth")), self.traced, self.depth_health)
        self.hand_over()

    def look(self, surface: Dem, hours: float) -> None:
        parts = measured_messages(self.small, surface, BEGIN_NS + round(hours * HOUR))
        listens = {topic.name: take for topic, take in self.terrain.subscriptions.items()}
        for topic, message in parts.items():
            if topic in (POSED_CAMERA_INFO, POSED_POSE):
                self.depth.subscriptions[topic](message)
            listens[camera_topic(NAME, "mast", topic)](message)
        self.terrain.idle()
        self.hand_over()

    def hand_over(self) -> None:
        """What the terrain has said last of its surface goes to the depth node."""
        listens = {topic.name: take for topic, take in self.depth.subscriptions.items()}
        listens[SURFACE](self.told.on(TERRAIN_SURFACE)[-1])

    @property
    def versions(self) -> list[str]:
        """To which each frame was traced."""
        return [msg_to_version(message) for message in self.traced.on(DEPTH_INFO)]

    def error(self, truth: Dem) -> float:
        """Median, metres, of the last frame over what has changed."""
        message = measured_messages(self.small, truth, 0)
        camera, pose = msg_to_camera(message[POSED_CAMERA_INFO]), msg_to_pose(message[POSED_POSE], "map")
        was, now = (TerrainTracer(dem).trace(camera, pose).depth() for dem in (self.small.dem, truth))
        found = msg_to_depth(self.traced.on(DEPTH_IMAGE)[-1])
        known = np.isfinite(was) & np.isfinite(now) & np.isfinite(found)
        was, now, found = was[known], now[known], found[known]
        return float(np.median(np.abs(found - now)[np.abs(was - now) > 1.0]))

    def _given(self, label: str) -> dict[str, Any]:
        return {k: v for k, v in self.graph.node(label).parameters.items() if k != "use_sim_time"}


@pytest.fixture
def chain(small: SmallSite, tmp_path: Path) -> Chain:
    return Chain(small, tmp_path / "state")


def test_later_frames_are_traced_to_what_was_confirmed(chain: Chain) -> None:
    truth = sunk(chain.small)
    for hours in (0, 2):
        chain.look(truth, hours)
    before = chain.error(truth)
    assert chain.versions == ["", ""], "old frames keep the version they were traced with"
    told = msg_to_values(chain.told.on(TERRAIN_SURFACE)[-1])
    chain.look(truth, 4)
    assert chain.versions[-1] == told["version"] != ""
    assert chain.error(truth) < 0.5 * before
    assert told["digest"].startswith(told["version"])
    assert 0 < float(told["changed_share"]) < 1
    assert told["lowered"] == told["changed"]
    assert int(told["changed"]) > 50
    assert chain.health.dropped == chain.depth_health.dropped == {}


def test_a_kill_before_the_version_was_written_is_made_good_without_a_frame(chain: Chain) -> None:
    for hours in (0, 2):
        chain.look(sunk(chain.small), hours)
    shutil.rmtree(chain.folder)
    chain.restart()
    assert msg_to_version(chain.told.on(TERRAIN_SURFACE)[-1]) == ""
    chain.terrain.tick(0.5)
    assert msg_to_version(chain.told.on(TERRAIN_SURFACE)[-1]) != ""


def test_where_no_version_can_be_written_the_terrain_goes_on_and_tries_again(
    chain: Chain, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(versions: SurfaceVersions, *_: Any) -> None:
        raise StoreError(f"{versions.folder}: cannot be written (No space left on device)")

    truth = sunk(chain.small)
    chain.terrain.tick(0.5)
    with monkeypatch.context() as broken:
        broken.setattr(SurfaceVersions, "add", full)
        for hours in (0, 2):
            chain.look(truth, hours)
            chain.terrain.tick(0.5)
        assert "No space left on device); the previous surface stays in use" in chain.health.last_error
        assert len(chain.told.on(TERRAIN_UPDATE)) == 1
        chain.look(chain.small.dem, 4)
        chain.look(chain.small.dem, 6)
        chain.terrain.tick(0.5)
        assert len(chain.told.on(TERRAIN_UPDATE)) == 2, "what is decided does not wait for the version"
    assert msg_to_version(chain.told.on(TERRAIN_SURFACE)[-1]) == ""
    chain.look(truth, 8)
    chain.terrain.tick(30.0)
    assert msg_to_version(chain.told.on(TERRAIN_SURFACE)[-1]) != ""


@pytest.mark.parametrize("when", ["at the start", "meanwhile"])
def test_a_broken_list_of_surfaces_is_told_and_put_aside_and_the_terrain_lives(chain: Chain, when: str) -> None:
    truth = sunk(chain.small)
    for hours in (0, 2):
        chain.look(truth, hours)
    if when == "at the start":
        (chain.folder / MANIFEST).write_text("{")
        chain.restart()
    else:
        (chain.folder / MANIFEST).write_text("{")
    for hours in (4, 6, 8):
        chain.look(truth, hours)
    assert "it was moved to" in chain.health.last_error
    assert (chain.folder.with_name(f"{FOLDER}.1") / MANIFEST).read_text() == "{"
    assert chain.versions[-1] != ""
    assert msg_to_version(chain.told.on(TERRAIN_SURFACE)[-1]) == chain.versions[-1]


@pytest.mark.parametrize(
    "values",
    [{}, *({"version": v} for v in ("../../../../etc/x", "0123456789abcdeF", "0123456789abcdef\n", "0" * 5000))],
)
def test_no_name_from_the_wire_reaches_the_file_system(chain: Chain, values: dict[str, str]) -> None:
    listens = {topic.name: take for topic, take in chain.depth.subscriptions.items()}
    with pytest.raises(MessageError):
        listens[SURFACE](status_to_msg("terrain/surface", 0, values))


def test_a_version_that_the_manifest_does_not_name_is_not_followed(chain: Chain) -> None:
    listens = {topic.name: take for topic, take in chain.depth.subscriptions.items()}
    listens[SURFACE](status_to_msg("terrain/surface", 0, {"version": "0123456789abcdef"}))
    chain.look(chain.small.dem, 0)
    assert chain.versions == [""]
