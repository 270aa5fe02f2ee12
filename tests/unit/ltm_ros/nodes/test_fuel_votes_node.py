from pathlib import Path

import numpy as np
import pytest
import yaml
from scenes.outlets import Kept
from scenes.small_site import BEGIN_NS, GRASS, MAST, SmallSite, write_small_site

from ltm_core.vision.labels import Label
from ltm_msgs_py.image import depth_to_msg, image_to_msg
from ltm_msgs_py.pointcloud import msg_to_votes
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.nodes.fuel_votes import FuelVotesHandler
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.stamp_join import JoinConfig
from ltm_ros.runtime.topics import (
    DEPTH_CAMERA_INFO,
    DEPTH_IMAGE,
    FUEL_VOTES,
    LABELS_CONFIDENCE,
    LABELS_IMAGE,
    POSED_POSE,
)

pytestmark = pytest.mark.kernel


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> SmallSite:
    return write_small_site(tmp_path_factory.mktemp("hollow"), recording=False)


def frames_counted(
    small: SmallSite, folder: Path, label: int, times: int, **growth: float
) -> tuple[int, dict[str, str]]:
    """Pixels that vote of the mast's frames, all of them of one label, and what /diagnostics says."""
    content = yaml.safe_load(small.path.read_text())
    content |= {"dem": {"path": str(small.folder / "dem.tif")}, "model": str(small.folder / content["model"])}
    path = folder / "site.yaml"
    slope = {name: growth.pop(name) for name in ("steepest_deg",) if name in growth}
    content["expert"] = {"fuel": {"growth": slope}}
    path.write_text(yaml.safe_dump(content | {"fuel": {"growth": growth}}))
    outlet, health = Kept(), Health()
    handler = FuelVotesHandler(JoinConfig(site=str(path), camera="mast"), outlet, health)
    pose = next(frame.pose for frame in small.frames(1) if frame.camera_name == "mast")
    depth = small.tracer.trace(MAST, pose).depth()
    labels = np.full(depth.shape, label, np.uint8)
    for stamp in range(BEGIN_NS, BEGIN_NS + times):
        parts = {
            DEPTH_IMAGE: depth_to_msg(depth, stamp, "mast_optical"),
            DEPTH_CAMERA_INFO: camera_to_msg(MAST, stamp, "mast_optical"),
            LABELS_IMAGE: image_to_msg(labels, "mono8", stamp, "mast_optical"),
            LABELS_CONFIDENCE: image_to_msg(labels + np.uint8(200), "mono8", stamp, "mast_optical"),
            POSED_POSE: pose_to_msg(pose, stamp),
        }
        for topic, message in parts.items():
            handler.subscriptions[topic](message)
    sent = [message for topic, message in outlet.sent if topic is FUEL_VOTES]
    assert len(sent) == times
    step = handler._step
    votes = msg_to_votes(sent[-1], step.geometry, step.labels.names, "mast")
    return int(votes.counts.sum()), health.summary()


def test_withdrawn_pixels_are_counted_by_reason(small: SmallSite, tmp_path: Path) -> None:
    low, _ = np.nanpercentile(small.dem.elevation, [40, 60])
    everything, summary = frames_counted(small, tmp_path, Label.TREE, 1, steepest_deg=89.9)
    assert not [key for key in summary if key.startswith("withdrawn")]
    left, summary = frames_counted(small, tmp_path, Label.TREE, 2, steepest_deg=89.9, tree_line_m=float(low))
    assert 0 < left < everything
    assert 2 * (everything - left) >= int(summary["withdrawn.above_tree_line"]) > 0
    assert "withdrawn.too_steep" not in summary
    left, summary = frames_counted(small, tmp_path, GRASS, 1, steepest_deg=8.0)
    assert 0 < left < everything
    assert everything - left >= int(summary["withdrawn.too_steep"]) > 0
