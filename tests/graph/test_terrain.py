"""The living surface as processes on real DDS: from photos to maps, killed, and fed with what no camera should send."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
from bystander import Bystander
from scenes.small_site import BEGIN_NS, NAME, SmallSite
from scenes.terrain_frames import (
    HOUR,
    block_cells,
    built_up,
    mast_pose,
    measured_messages,
    photo_of_depth,
    sunk,
    write_fusing_site,
    write_terrain_site,
)
from scenes.waiting import wait_for

from ltm_core.pipeline.site_surface import STORE_FILE
from ltm_core.storage.tile_store import TileStore
from ltm_msgs_py.cells import msg_to_changed
from ltm_msgs_py.grid import msg_to_classes
from ltm_msgs_py.image import depth_to_msg, image_to_msg
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.supervisor import RestartPolicy
from ltm_ros.runtime.topics import (
    IMAGE_RAW,
    LABELS_IMAGE,
    MEASURED_DEPTH,
    MEASURED_SIGMA,
    POSED_CAMERA_INFO,
    POSED_POSE,
    TERRAIN_CHANGE,
    TERRAIN_INFO,
    TERRAIN_UPDATE,
    camera_topic,
    site_topic,
)

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("kernels")]

NODE = f"/{NAME}/terrain"
UPDATE, CHANGE, INFO = (site_topic(NAME, topic) for topic in (TERRAIN_UPDATE, TERRAIN_CHANGE, TERRAIN_INFO))
PARTS = (LABELS_IMAGE, POSED_CAMERA_INFO, POSED_POSE, MEASURED_SIGMA, MEASURED_DEPTH)


def running(small: SmallSite, labels: tuple[str, ...], domain: int, logs: Path, **parameters: Any) -> Runner:
    whole = describe(small.site, small.path, parameters={"terrain": parameters})
    return Runner(
        Graph(NAME, tuple(whole.node(label) for label in labels)),
        domain_id=domain,
        log_folder=logs,
        console=lambda line: None,
        policy=RestartPolicy(initial_s=0.1, maximum_s=1.0),
    )


def test_photos_become_a_changed_surface(ros_domain: int, tmp_path: Path) -> None:
    """A block stands in the mast's view since the DEM was made: photos go in, the changed surface comes out."""
    (tmp_path / "site").mkdir()
    small = write_fusing_site(tmp_path / "site")
    folder = tmp_path / "kept"
    labels = ("terrain", *(f"mast/{kind}" for kind in ("capture", "depth", "segmentation", "topodepth")))
    photo = photo_of_depth(built_up(small), small.site.camera("mast").calibration.camera(), mast_pose(small))
    images = camera_topic(NAME, "mast", IMAGE_RAW)
    with running(small, labels, ros_domain, tmp_path / "log", folder=str(folder)) as runner, Bystander() as bystander:
        runner.wait_until_ready(300.0)
        bystander.listen(UPDATE, TERRAIN_UPDATE.type)
        bystander.open(images, IMAGE_RAW.type)
        bystander.wait_for_wiring(len(labels))
        saved, answer = bystander.call(f"{NODE}/save")
        assert not saved
        assert "nothing to write" in answer
        for look in range(3):
            bystander.send(images, image_to_msg(photo, "rgb8", BEGIN_NS + look * 2 * HOUR, "mast_optical"))
            wait_for(
                lambda n=look + 1: bystander.count(NODE, "frames") == n,
                f"{look + 1} frames in the terrain",
                lambda: bystander.summaries,
            )
            assert look > 0 or bystander.heard[UPDATE] == [], "one view has changed the map"
        wait_for(lambda: bystander.heard[UPDATE], "an update", lambda: bystander.summaries)
        parts = [msg_to_changed(message)[0] for message in list(bystander.heard[UPDATE])]
        # Who comes late learns of all that has changed.
        bystander.listen(CHANGE, TERRAIN_CHANGE.type, latched=True)
        bystander.listen(INFO, TERRAIN_INFO.type, latched=True)
        wait_for(lambda: bystander.heard[INFO] and bystander.heard[CHANGE], "the latched topics")
        info = json.loads(bystander.heard[INFO][-1].data)
        done, answer = bystander.call(f"{NODE}/save")
        assert done, answer
        # The grid goes out at the node's own pace.
        told = int(sum((part.kind > 0).sum() for part in parts) - sum((part.kind == 0).sum() for part in parts))
        wait_for(
            lambda: int((msg_to_classes(bystander.heard[CHANGE][-1])[0] == info["kinds"]["grown"]).sum()) == told,
            f"{told} cells in the latched grid",
        )
        assert {int(v) for v in bystander.dropped(NODE).values()} == set()
    block = block_cells(small)
    rows, cols = (np.concatenate([getattr(part, name) for part in parts]) for name in ("rows", "cols"))
    shifts = np.concatenate([part.shift for part in parts])
    # The test's network sees 48 x 32 pixels, of some 20 m there: it draws the block's outline no finer.
    about = cv2.dilate(block.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(np.bool_)
    assert block[rows, cols].sum() > 10
    assert about[rows, cols].mean() > 0.6
    assert np.median(shifts[block[rows, cols]]) > 5.0

    layers = {}
    for name in ("height", "sigma", "change", "age"):
        with rasterio.open(folder / f"terrain_{name}.tif") as file:
            assert str(file.crs) == "EPSG:26911"
            assert file.res == (10.0, 10.0)
            layers[name] = file.read(1)
            place = file.transform
    changed = layers["change"] == info["kinds"]["grown"]
    assert int(changed.sum()) == told
    # The files hold the tiles that were looked at.
    whole = small.site.in_crs(small.dem.geometry)
    top, left = round((whole.y_max - place.f) / 10.0), round((place.c - whole.x_min) / 10.0)
    rows_of, cols_of = layers["height"].shape
    was = small.dem.elevation[top : top + rows_of, left : left + cols_of]
    assert was.shape == layers["height"].shape
    assert (layers["height"][changed] > was[changed]).all()
    np.testing.assert_allclose(layers["height"][~changed], was[~changed], atol=1e-3)
    assert (layers["sigma"][changed] > 0).all()
    assert (layers["age"][changed] <= 4.0).all()


@pytest.fixture(scope="module")
def terrain_site(tmp_path_factory: pytest.TempPathFactory) -> SmallSite:
    return write_terrain_site(tmp_path_factory.mktemp("terrain_site"))


class Living:
    """A terrain node that runs, and a mast that sends fused depth to it."""

    def __init__(self, small: SmallSite, runner: Runner, bystander: Bystander) -> None:
        self.small, self.runner, self.bystander = small, runner, bystander
        bystander.listen(UPDATE, TERRAIN_UPDATE.type)
        for topic in PARTS:
            bystander.open(camera_topic(NAME, "mast", topic), topic.type)
        bystander.wait_for_wiring(1)
        self._sent = 0

    def send(self, parts: dict[Any, Any]) -> None:
        for topic, message in parts.items():
            self.bystander.send(camera_topic(NAME, "mast", topic), message)
        self._sent += len(parts)

    def wait_taken(self) -> None:
        """Until the node has done with all that was sent: DDS holds ten of a topic, the node's inbox a hundred, and a
        busy machine is slow to read."""
        wait_for(
            lambda: (
                self.bystander.count(NODE, "received") >= self._sent
                and self.bystander.count(NODE, "queue") <= 1  # a tick
            ),
            f"{self._sent} messages",
            lambda: self.bystander.summaries,
        )

    def wait_frames(self, frames: int) -> None:
        wait_for(
            lambda: self.bystander.count(NODE, "frames") == frames, f"{frames} frames", lambda: self.bystander.summaries
        )

    def counted(self) -> dict[str, int]:
        """Drops and notes, from diagnostics that came after this call; less that stamps jump, as a test's do."""
        self.bystander.forget()
        wait_for(lambda: NODE in self.bystander.summaries, "diagnostics")
        latest = self.bystander.summaries[NODE]
        counters = {k: int(v) for k, v in latest.items() if k.startswith(("dropped.", "noted."))}
        counters.pop("noted.stamp_jump", None)
        return counters


@pytest.fixture
def living(ros_domain: int, terrain_site: SmallSite, tmp_path: Path) -> Iterator[Living]:
    parameters = {"folder": str(tmp_path / "kept"), "depth_from_elsewhere": True, "commit_every": 2.0}
    runner = running(terrain_site, ("terrain",), ros_domain, tmp_path / "log", **parameters)
    with runner, Bystander() as bystander:
        runner.wait_until_ready(300.0)
        yield Living(terrain_site, runner, bystander)


def test_what_was_told_of_outlives_kills(living: Living, tmp_path: Path) -> None:
    small, bystander = living.small, living.bystander
    process = living.runner.processes["terrain"]
    truth = sunk(small)
    for look in (0, 2):
        living.send(measured_messages(small, truth, BEGIN_NS + look * HOUR))
    wait_for(lambda: bystander.heard[UPDATE], "an update", lambda: bystander.summaries)
    for kill in range(2):
        starts = process.starts
        living.send(measured_messages(small, truth, BEGIN_NS + (10 + kill) * HOUR))
        living.runner.kill("terrain")
        wait_for(lambda n=starts: process.starts == n + 1 and process.running, "the node again")
        bystander.forget()
        bystander.wait_for_wiring(1)

        # All frames come again: those that were told of are known, the others are counted now.
        def send_all(kill: int = kill) -> None:
            for look in (0, 2, *range(10, 11 + kill)):
                living.send(measured_messages(small, truth, BEGIN_NS + look * HOUR))

        frames = 3 + kill
        bystander.send_until(send_all, lambda n=frames: bystander.count(NODE, "frames") == n, f"{frames} frames")
        assert living.counted()["dropped.duplicate"] >= 2
    told: dict[tuple[int, int], int] = {}
    for message in bystander.heard[UPDATE]:
        changed, _ = msg_to_changed(message)
        told |= dict(zip(zip(changed.rows.tolist(), changed.cols.tolist(), strict=True), changed.kind, strict=True))
    done, answer = bystander.call(f"{NODE}/save")
    assert done, answer
    with rasterio.open(tmp_path / "kept" / "terrain_change.tif") as file:
        kinds = file.read(1)
    assert {cell for cell, kind in told.items() if kind > 0} == set(zip(*np.nonzero(kinds % 255), strict=True))
    with TileStore.open_read_only(tmp_path / "kept" / STORE_FILE, "terrain") as store:
        assert store.frame_count() == 4
        stored = {key: tile["kind"] for key, tile in store.tiles()}
    assert sum(int((kind > 0).sum()) for kind in stored.values()) == int((kinds % 255 > 0).sum()) > 50


def test_hostile_frames_are_counted_and_change_nothing(living: Living) -> None:
    small, bystander = living.small, living.bystander
    pid = living.runner.processes["terrain"].pid
    look = iter(range(1000))
    expected: dict[str, int] = {}

    def hostile(cause: str, **changes: Callable[[Any], Any]) -> None:
        """A frame of the changed surface, each of the named parts spoiled; `cause`: what must count it."""
        stamp = BEGIN_NS + next(look) * HOUR
        parts = measured_messages(small, sunk(small), stamp)
        for topic in PARTS:
            spoil = changes.get(topic.name.replace("/", "_"))
            if spoil is not None:
                parts[topic] = spoil(parts[topic]) or parts[topic]
        living.send(parts)
        expected[cause] = expected.get(cause, 0) + 1
        if sum(expected.values()) % 8 == 0:
            living.wait_taken()

    def vast(message: Any) -> None:
        message.width = message.height = message.step = 2**32 - 1

    def short(message: Any) -> None:
        message.data = message.data[:-1]

    def filled(value: float) -> Callable[[Any], Any]:
        def make(message: Any) -> Any:
            depth = np.full((message.height, message.width), value, np.float32)
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            return depth_to_msg(depth, stamp, "mast_optical")

        return make

    def other_size(message: Any) -> None:
        message.height -= 1
        message.data = message.data[: message.height * message.step]

    def other_encoding(message: Any) -> None:
        message.encoding = "rgba8"

    def huge_camera(message: Any) -> None:
        message.width = message.height = 2**31

    def uncalibrated(message: Any) -> None:
        message.k = np.zeros(9)

    def position(**to: float) -> Callable[[Any], None]:
        def move(message: Any) -> None:
            for name, value in to.items():
                setattr(message.pose.pose.position, name, value)

        return move

    def no_turn(message: Any) -> None:
        for name in "xyzw":
            setattr(message.pose.pose.orientation, name, 0.0)

    def covariance(value: float) -> Callable[[Any], None]:
        def fill(message: Any) -> None:
            message.pose.covariance[21] = value

        return fill

    def odom(message: Any) -> None:
        message.header.frame_id = "odom"

    hostile("noted.nothing_seen", measured_depth=filled(np.nan))
    hostile("noted.nothing_seen", measured_depth=filled(-3.0))
    hostile("noted.nothing_seen", measured_sigma=filled(np.nan))
    hostile("noted.nothing_seen", measured_sigma=filled(-1.0))
    hostile("noted.nothing_seen", measured_sigma=filled(np.inf))
    hostile("noted.nothing_seen", posed_pose=position(x=1e9))
    hostile("noted.nothing_seen", posed_pose=position(x=-1e300, z=1e300))
    for topic in ("measured_depth", "measured_sigma"):
        for spoil in (vast, short, other_size, other_encoding):
            hostile("dropped.image", **{topic: spoil})
    hostile("dropped.camera", posed_camera_info=huge_camera)
    hostile("dropped.camera", posed_camera_info=uncalibrated)
    hostile("dropped.pose", posed_pose=position(z=-500.0))
    hostile("dropped.pose", posed_pose=position(y=float("nan")))
    hostile("dropped.pose", posed_pose=no_turn)
    hostile("dropped.pose", posed_pose=covariance(float("nan")))
    hostile("dropped.pose", posed_pose=covariance(-1.0))
    hostile("dropped.pose", posed_pose=odom)
    living.wait_taken()
    frames = 7
    # Stamps: of a clock that was never set, and negative.
    living.send(measured_messages(small, sunk(small), 7))
    expected["dropped.unset_clock"] = 1
    negative = measured_messages(small, sunk(small), BEGIN_NS)
    for message in negative.values():
        message.header.stamp.sec = -5
    living.send(negative)
    expected["dropped.message"] = len(negative)
    # Whoever forges a frame an hour ahead of everybody's clock.
    now = bystander.node.get_clock().now().nanoseconds
    living.send(measured_messages(small, sunk(small), now + HOUR))
    expected["dropped.future"] = 1
    # A camera that the site does not have, and bytes that are no message.
    stranger = camera_topic(NAME, "stranger", MEASURED_DEPTH)
    bystander.open(stranger, MEASURED_DEPTH.type, listeners=0)
    bystander.send(stranger, measured_messages(small, sunk(small), BEGIN_NS)[MEASURED_DEPTH])
    for topic in PARTS:
        bystander.send(camera_topic(NAME, "mast", topic), b"\x00\x01\x00\x00\xff")
    expected["dropped.lost"] = len(PARTS)
    # Stamps backwards and twice: good frames of an unchanged surface, newest first.
    for hours in (2000, 1990, 2000, 1980):
        living.send(measured_messages(small, small.dem, BEGIN_NS + hours * HOUR))
    expected["dropped.duplicate"] = len(PARTS) - 1
    frames += 3
    living.wait_frames(frames)
    assert living.counted() == expected
    assert bystander.heard[UPDATE] == []
    assert living.runner.processes["terrain"].pid == pid
    assert living.runner.processes["terrain"].starts == 1
    # And it works as before.
    for hours in (3000, 3002, 3004):
        living.send(measured_messages(small, sunk(small), BEGIN_NS + hours * HOUR))
    wait_for(lambda: bystander.heard[UPDATE], "an update", lambda: bystander.summaries)
