import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import yaml
from scenes.outlets import Kept
from scenes.small_site import BEGIN_NS, MAST, NAME, SmallSite
from scenes.terrain_frames import HOUR, measured_messages, sunk, write_terrain_site

from ltm_core.base.errors import LtmError, StoreError
from ltm_core.pipeline.site_surface import STORE_FILE
from ltm_core.raster.dem import Dem
from ltm_core.storage.tile_store import TileStore
from ltm_core.surface.change import ChangeKind
from ltm_core.vision.labels import Label
from ltm_msgs_py.cells import msg_to_changed
from ltm_msgs_py.grid import msg_to_classes
from ltm_msgs_py.image import depth_to_msg, image_to_msg, msg_to_depth
from ltm_ros.nodes.terrain import TerrainHandler, TerrainNodeConfig
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import (
    LABELS_IMAGE,
    MEASURED_DEPTH,
    MEASURED_SIGMA,
    TERRAIN_CHANGE,
    TERRAIN_INFO,
    TERRAIN_UPDATE,
    camera_topic,
)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> SmallSite:
    return write_terrain_site(tmp_path_factory.mktemp("site"))


def node(small: SmallSite, **parameters: Any) -> tuple[TerrainHandler, Kept, Health]:
    outlet, health = Kept(), Health()
    config = TerrainNodeConfig(site=str(small.path), depth_from_elsewhere=True, **parameters)
    terrain = TerrainHandler(config, outlet, health)
    terrain.start()
    return terrain, outlet, health


def feed(terrain: TerrainHandler, parts: dict[Any, Any]) -> None:
    listens = {topic.name: callback for topic, callback in terrain.subscriptions.items()}
    for topic, message in parts.items():
        listens[camera_topic(NAME, "mast", topic)](message)
    terrain.idle()


def test_change_goes_out_once_views_agree(small: SmallSite) -> None:
    terrain, outlet, health = node(small)
    truth = sunk(small)
    feed(terrain, measured_messages(small, truth, BEGIN_NS))
    assert outlet.on(TERRAIN_UPDATE) == []
    feed(terrain, measured_messages(small, truth, BEGIN_NS + 2 * HOUR))
    (update,) = outlet.on(TERRAIN_UPDATE)
    changed, places = msg_to_changed(update)
    was = small.dem.elevation[changed.rows, changed.cols]
    true = truth.elevation[changed.rows, changed.cols]
    z = places[:, 2]
    assert len(z) > 50
    assert np.median(np.abs(z - true)) < 0.3 * np.median(np.abs(was - true))
    terrain.finish()
    kinds, geometry = msg_to_classes(outlet.on(TERRAIN_CHANGE)[-1])
    assert set(np.unique(kinds)) <= {0, 3, 255}
    assert int((kinds == 3).sum()) == len(z)
    said = health.summary()
    assert (said["cells.lowered"], said["cells.grown"]) == (str(len(z)), "0")
    assert int(said["cells.seen"]) >= int(said["cells.judged"]) == int((kinds != 255).sum())
    assert geometry.resolution == 10.0
    info = json.loads(outlet.on(TERRAIN_INFO)[0].data)
    assert (info["kinds"]["grown"], info["resolution"], info["cameras"]) == (2, 10.0, ["mast", "tower"])
    assert health.dropped == {}


def test_what_no_network_measures_never_becomes_change(small: SmallSite) -> None:
    """As where the network fails, or the pose is suspected: one pixel that is NaN."""
    terrain, outlet, health = node(small)
    for hours in (0, 2):
        stamp = BEGIN_NS + hours * HOUR
        nothing = depth_to_msg(np.full((1, 1), np.nan, np.float32), stamp, "mast_optical")
        sent = measured_messages(small, sunk(small), stamp)
        feed(terrain, sent | {MEASURED_DEPTH: nothing, MEASURED_SIGMA: nothing})
    assert outlet.on(TERRAIN_UPDATE) == []
    assert health.summary()["noted.nothing_seen"] == "2"


def test_a_camera_tells_by_its_labels_that_a_wood_is_gone(tmp_path: Path) -> None:
    """Every second square of 12 x 12 cells is wood in the surface raster, and the network hardly measures anything."""
    rows = {form: {form: 0.8, "bare": 0.1, "shrub": 0.1} for form in ("grass", "tree")}
    rows |= {form: {form: 0.8, "grass": 0.2} for form in ("shrub", "bare", "water", "built")}
    correlation = {"cell": 0.78, "stand": 0.33, "view": 0.72, "network": 0.34}
    record = {"source": "assumed by this test", "photos": 1, "shares": rows, "correlation": correlation}
    (tmp_path / "errors.yaml").write_text(yaml.safe_dump(record))
    rules = {"fuel": {"label_errors": "errors.yaml"}, "terrain": {"threshold": 2.0, "register_frames": False}}
    wooded = write_terrain_site(tmp_path, surface={"path": "tops.tif"}, expert=rules)
    tops = Dem(2 * wooded.dem.elevation - sunk(wooded).elevation, wooded.dem.geometry)
    with rasterio.open(tmp_path / "dem.tif") as bare, rasterio.open(tmp_path / "tops.tif", "w", **bare.profile) as file:
        file.write(tops.elevation.astype(bare.dtypes[0]), 1)
    terrain, outlet, health = node(wooded)

    def look(hours: float, label: Label) -> None:
        stamp = BEGIN_NS + round(hours * HOUR)
        ids = image_to_msg(np.full((MAST.height, MAST.width), label, np.uint8), "mono8", stamp, "mast_optical")
        parts = measured_messages(wooded, tops, stamp)
        unsure = depth_to_msg(0.2 * msg_to_depth(parts[MEASURED_DEPTH]), stamp, "mast_optical")
        feed(terrain, parts | {LABELS_IMAGE: ids, MEASURED_SIGMA: unsure})

    for hours in (0.0, 1.1, 2.2):
        look(hours, Label.TREE)
    look(30.0, Label.GRASS)
    assert outlet.on(TERRAIN_UPDATE) == []
    look(51.0, Label.GRASS)
    (update,) = outlet.on(TERRAIN_UPDATE)
    changed, places = msg_to_changed(update)
    z = places[:, 2]
    assert len(z) > 50
    assert set(np.unique(changed.kind)) == {ChangeKind.REMOVED}
    assert np.median(np.abs(z - wooded.dem.elevation[changed.rows, changed.cols])) < 1.0
    assert health.dropped == {}


def test_depth_may_be_of_a_networks_size(small: SmallSite) -> None:
    """Every second column of what was sent before: the same cells change, but for those between."""
    found = []
    for rows, cols in ((1, 1), (1, 2)):
        terrain, outlet, _ = node(small)
        for hours in (0, 2):
            stamp = BEGIN_NS + hours * HOUR
            sent = measured_messages(small, sunk(small), stamp)
            for topic in (MEASURED_DEPTH, MEASURED_SIGMA):
                image = msg_to_depth(sent[topic])
                part = image[rows // 2 :: rows, cols // 2 :: cols][: image.shape[0] // rows, : image.shape[1] // cols]
                sent[topic] = depth_to_msg(part.copy(), stamp, "mast_optical")
            feed(terrain, sent)
        changed, _ = msg_to_changed(outlet.on(TERRAIN_UPDATE)[-1])
        found.append(set(zip(changed.rows.tolist(), changed.cols.tolist(), strict=True)))
    whole, part = found
    assert len(part & whole) > 0.9 * len(part)
    assert 0.3 * len(whole) < len(part) < len(whole)


def test_the_surface_is_kept(small: SmallSite, tmp_path: Path) -> None:
    folder = tmp_path / "kept"
    truth = sunk(small)
    terrain, _, _ = node(small, folder=str(folder))
    feed(terrain, measured_messages(small, truth, BEGIN_NS))
    terrain.finish()
    terrain, outlet, health = node(small, folder=str(folder))
    feed(terrain, measured_messages(small, truth, BEGIN_NS))
    assert health.dropped == {"duplicate": 1}
    feed(terrain, measured_messages(small, truth, BEGIN_NS + 2 * HOUR))
    assert len(outlet.on(TERRAIN_UPDATE)) == 1
    terrain.finish()


def test_what_was_told_of_is_kept_and_what_cannot_be_kept_is_told_of_later(
    small: SmallSite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "kept"
    terrain, outlet, health = node(small, folder=str(folder))
    feed(terrain, measured_messages(small, sunk(small), BEGIN_NS))
    with monkeypatch.context() as broken:

        def full(*_: Any) -> None:
            raise StoreError("no space left")

        broken.setattr(TileStore, "commit", full)
        feed(terrain, measured_messages(small, sunk(small), BEGIN_NS + 2 * HOUR))
        assert outlet.on(TERRAIN_UPDATE) == []
        assert (health.dropped, health.troubled) == ({}, True), "nothing is lost so far"
        assert "no space left; 2 frames are in memory only" in health.last_error
    terrain.idle()
    (update,) = outlet.on(TERRAIN_UPDATE)
    changed, _ = msg_to_changed(update)
    with TileStore.open_read_only(folder / STORE_FILE, "terrain") as store:
        assert store.frame_count() == 2
        assert sum(len(change.rows) for change in store.changes("change")) == len(changed.rows)
        assert sum(int((tile["kind"] > 0).sum()) for _, tile in store.tiles()) == len(changed.rows)


def test_bad_frames_are_dropped_by_their_cause(small: SmallSite) -> None:
    terrain, outlet, health = node(small)

    def fails(kind: str, **parts: Any) -> None:
        message = measured_messages(small, small.dem, BEGIN_NS + fails.number * HOUR)  # type: ignore[attr-defined]
        fails.number += 1  # type: ignore[attr-defined]
        given = {topic: parts.get(topic.name.replace("/", "_"), lambda m: m)(m) for topic, m in message.items()}
        with pytest.raises(LtmError) as caught:
            feed(terrain, given)
        assert type(caught.value).__name__ == kind, caught.value

    fails.number = 0  # type: ignore[attr-defined]

    def nan_pose(message: Any) -> Any:
        message.pose.pose.position.x = float("nan")
        return message

    def wild_covariance(message: Any) -> Any:
        message.pose.covariance[0] = float("nan")
        return message

    def small_image(message: Any) -> Any:
        return depth_to_msg(np.ones((5, 7), np.float32), BEGIN_NS + (fails.number - 1) * HOUR, "mast_optical")  # type: ignore[attr-defined]

    def underground(message: Any) -> Any:
        message.pose.pose.position.z -= 500.0
        return message

    fails("PoseError", posed_pose=nan_pose)
    fails("PoseError", posed_pose=wild_covariance)
    fails("ImageError", measured_sigma=small_image)
    fails("PoseError", posed_pose=underground)
    feed(terrain, measured_messages(small, small.dem, BEGIN_NS + 40 * HOUR))
    assert outlet.on(TERRAIN_UPDATE) == []
    terrain.finish()
    assert health.dropped == {}
