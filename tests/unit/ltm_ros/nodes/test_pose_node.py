import os
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scenes.mountain_view import CAMERA, view, write_site
from scenes.mountain_view import TRUE as STATED
from scenes.outlets import Kept

from ltm_core.geometry.pose import pose_covariance
from ltm_core.pose_estimation.mount.mount_model import PoseCorrection
from ltm_core.pose_estimation.skyline.pose_prior import angles_between, turned
from ltm_core.site.site_io import load_site
from ltm_msgs_py.image import image_to_msg
from ltm_msgs_py.pose import correction_to_msg, msg_to_covariance, msg_to_pose, msgs_to_correction, pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_msgs_py.stamp import stamp_of
from ltm_msgs_py.status import msg_to_values
from ltm_ros.launching.graph import describe
from ltm_ros.nodes.capture import CaptureConfig, CaptureHandler
from ltm_ros.nodes.pose import PoseHandler, PoseKeepingConfig
from ltm_ros.recordings.replay.offline import OfflineGraph
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import (
    CAMERA_INFO,
    IMAGE_RAW,
    LABELS_IMAGE,
    POSE,
    POSE_CORRECTION,
    POSE_INFO,
    POSED_CAMERA_INFO,
    POSED_IMAGE,
    POSED_POSE,
    STATED_POSE,
)

STAMP = 1_700_000_000_000_000_000
SECOND = 1_000_000_000
TRUE = turned(STATED, np.radians([0.3, -0.25, -1.2]))
COVARIANCE = pose_covariance(STATED, 0.4, 0.7, 1.5, 0.5, 0.5)


def refined_site(folder: Path, **refine: Any) -> str:
    more = {"refine_poses": {}, "expert": {"refine_poses": refine}} if refine else {}
    return str(write_site(folder, name="rim", cameras={"mast": {"image": "raw"}}, **more))


def show(node: PoseHandler, stamp: int) -> None:
    """A picture from TRUE, said to be from STATED."""
    photo, labels = view(TRUE)
    noise = np.random.default_rng(stamp % 1000).normal(scale=3.0, size=photo.shape)
    image = np.clip(photo + noise, 0, 255).astype(np.uint8)
    node.subscriptions[STATED_POSE](pose_to_msg(STATED, stamp, "map", COVARIANCE))
    node.subscriptions[POSED_CAMERA_INFO](camera_to_msg(CAMERA, stamp, "mast_optical"))
    node.subscriptions[POSED_IMAGE](image_to_msg(image, "rgb8", stamp, "mast_optical"))
    node.subscriptions[LABELS_IMAGE](image_to_msg(labels, "mono8", stamp, "mast_optical"))


def test_what_is_found_reaches_the_frames(tmp_path: Path) -> None:
    site, kept, health = refined_site(tmp_path, every=10.0, gather=2), Kept(), Health()
    node = PoseHandler(PoseKeepingConfig(site=site, camera="mast"), kept, health)
    show(node, STAMP)
    show(node, STAMP + 3 * SECOND)  # too soon to be looked at
    assert not kept.on(POSE_CORRECTION)
    show(node, STAMP + 10 * SECOND)
    (correction,) = kept.on(POSE_CORRECTION)
    (info,) = kept.on(POSE_INFO)
    said = msg_to_values(info)
    assert (said["state"], stamp_of(info), said["slips"]) == ("held", STAMP + 10 * SECOND, "0")
    np.testing.assert_allclose([float(word) for word in said["rotation_deg"].split()], [0.3, -0.25, -1.2], atol=0.12)
    assert health.summary()["noted.clear"] == "2"
    assert health.summary()["mount"].startswith("held")

    sent = Kept()
    capture = CaptureHandler(CaptureConfig(site=site, camera="mast"), sent, Health())
    for stamp in (STAMP, STAMP + SECOND):
        if stamp > STAMP:
            capture.subscriptions[POSE_INFO](info)
            capture.subscriptions[POSE_CORRECTION](correction)
        image = image_to_msg(np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8), "rgb8", stamp, "mast_optical")
        capture.subscriptions[CAMERA_INFO](camera_to_msg(CAMERA, stamp, "mast_optical"))
        capture.subscriptions[POSE](pose_to_msg(STATED, stamp, "map", COVARIANCE))
        capture.subscriptions[IMAGE_RAW](image)
    before, after = sent.on(POSED_POSE)
    np.testing.assert_allclose(msg_to_pose(before, "map").rotation, STATED.rotation, atol=1e-9)
    assert np.degrees(np.abs(angles_between(msg_to_pose(after, "map"), TRUE))).max() < 0.12
    known = msg_to_covariance(after)
    assert known is not None
    np.testing.assert_allclose(known[:3, :3], COVARIANCE[:3, :3])
    assert known[5, 5] < COVARIANCE[5, 5]
    for stated in sent.on(STATED_POSE):  # what came is kept beside
        np.testing.assert_allclose(msg_to_pose(stated, "map").rotation, STATED.rotation, atol=1e-9)
        np.testing.assert_allclose(msg_to_covariance(stated), COVARIANCE)


def test_what_is_found_is_kept_over_a_restart(tmp_path: Path) -> None:
    """And told before the first picture where the site states the calibration; under other terms it is not used."""
    site = Path(refined_site(tmp_path, every=10.0, gather=2))
    folder = tmp_path / "state"
    calibration = {"width": CAMERA.width, "height": CAMERA.height, "fx": CAMERA.fx}

    def started(**camera: Any) -> tuple[PoseHandler, Kept, Health]:
        content = yaml.safe_load(site.read_text())
        content["cameras"]["mast"] = {"image": "raw"} | camera
        site.write_text(yaml.safe_dump(content))
        kept, health = Kept(), Health()
        node = PoseHandler(PoseKeepingConfig(site=str(site), camera="mast", folder=str(folder)), kept, health)
        node.start()
        return node, kept, health

    node, _, _ = started(calibration=calibration)
    show(node, STAMP)
    assert not folder.exists()
    show(node, STAMP + 10 * SECOND)
    assert [path.name for path in folder.iterdir()] == ["mount_mast.json"]

    _, kept, health = started(calibration=calibration)
    (correction,), info = kept.on(POSE_CORRECTION), kept.on(POSE_INFO)[-1]
    pose, known = msgs_to_correction(correction, info).applied(STATED, COVARIANCE)
    assert np.degrees(np.abs(angles_between(pose, TRUE))).max() < 0.12
    assert known[5, 5] < COVARIANCE[5, 5]
    assert health.summary()["mount"].startswith("held")

    for other in ({"calibration": calibration | {"fx": 1.01 * CAMERA.fx}}, {}):
        _, kept, health = started(**other)
        assert not kept.on(POSE_CORRECTION)
        assert "mount" not in health.summary()

    node, kept, _ = started()  # its calibration comes with the pictures, and is another's than the file's
    show(node, STAMP + 20 * SECOND)
    assert not kept.on(POSE_CORRECTION)

    dem = tmp_path / "dem.tif"
    os.utime(dem, ns=(1, 1))
    _, kept, _ = started(calibration=calibration)
    assert not kept.on(POSE_CORRECTION)

    (folder / "mount_mast.json").write_text('{"layout": 1, "rotation": [0.1]}')
    _, kept, health = started(calibration=calibration)
    assert not kept.on(POSE_CORRECTION)
    assert "not a valid mount state" in health.summary()["last_error"]


def test_the_correction_is_fed_back_within_a_graph(tmp_path: Path) -> None:
    """Which ends in order all the same: what is latched holds up nobody's end."""
    site = refined_site(tmp_path, every=0.0, gather=2)
    offline = OfflineGraph(describe(load_site(site), site))
    truth = PoseCorrection(np.array([0.0, 0.0, 0.02]), np.diag([1e-6, 1e-6, 1e-6]))
    offline.feed("/rim/mast/pose/correction", correction_to_msg(truth, STAMP), STAMP)
    offline.finish()
    assert {"/rim/mast/pose", "/rim/mast/capture"} <= offline.healths.keys()
