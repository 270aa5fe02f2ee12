from pathlib import Path

import numpy as np
import pytest
import yaml
from scenes.outlets import Kept
from scenes.small_site import BEGIN_NS, MAST, SmallSite, write_small_site

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
    small: SmallSite, folder: Path, label: int, times: int, steepest_deg: float
) -> tuple[int, dict[str, str]]:
    """Pixels that vote of the mast's frames, all of them of one label, and what /diagnostics says."""
    content = yaml.safe_load(small.path.read_text())
    content |= {"dem": {"path": str(small.folder / "dem.tif")}, "model": str(small.folder / content["model"])}
    path = folder / "site.yaml"
    content["expert"] = {"fuel": {"steepest_deg": steepest_deg}}
    path.write_text(yaml.safe_dump(content))
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


def test_withdrawn_pixels_are_counted(small: SmallSite, tmp_path: Path) -> None:
    everything, summary = frames_counted(small, tmp_path, Label.TREE, 1, 89.9)
    assert not [key for key in summary if key.startswith("withdrawn")]
    left, summary = frames_counted(small, tmp_path, Label.TREE, 2, 8.0)
    assert 0 < left < everything
    assert 2 * (everything - left) >= int(summary["withdrawn.too_steep"]) > 0
