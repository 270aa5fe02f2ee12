from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.site.site import Site
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import compressed_to_msg, depth_to_msg, encode_rgb, image_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.recordings.recorded_run import recorded_frames

CAMERA = Camera(18, 10, 20.0, 21.0, 8.5, 4.5)
POSE = Pose.from_angles((10.0, 20.0, 30.0), 45.0, -5.0)
SITE = Site(
    name="ridge",
    crs="EPSG:32611",
    origin=(0.0, 0.0),
    dem={"path": "dem.tif"},
    cameras={"north": {}, "east": {"image": "raw"}},
)
PHOTO = np.random.default_rng(4).integers(0, 255, (10, 18, 3)).astype(np.uint8)
DEPTH = np.arange(180, dtype=np.float32).reshape(10, 18) + 50
LABELS = (np.arange(180).reshape(10, 18) % 5).astype(np.uint8)


def frame(camera: str, stamp: int, **parts: Any) -> dict[str, Any]:
    """Topics and messages of one whole frame of a run; a part that is None is left out."""
    optical = f"{camera}_optical"
    jpeg = compressed_to_msg(encode_rgb(PHOTO, "png"), "png", stamp, optical)
    messages = {
        "depth/camera_info": camera_to_msg(CAMERA, stamp, optical),
        "posed/pose": pose_to_msg(POSE, stamp),
        "depth/image": depth_to_msg(DEPTH, stamp, optical),
        "labels/image": image_to_msg(LABELS, "mono8", stamp, optical),
    }
    messages |= (
        {"image_raw/compressed": jpeg}
        if camera == "north"
        else {"image_raw": image_to_msg(PHOTO, "rgb8", stamp, optical)}
    )
    messages |= {name.replace("__", "/"): message for name, message in parts.items()}
    return {f"/ridge/{camera}/{topic}": message for topic, message in messages.items() if message is not None}


def write(path: Path, *frames: tuple[int, dict[str, Any]]) -> Path:
    with BagWriter(path) as bag:
        for stamp, messages in frames:
            for topic, message in messages.items():
                bag.write(topic, message, stamp)
    return path


def test_frames_come_by_camera_and_time(tmp_path: Path) -> None:
    bag = write(
        tmp_path / "bag",
        (30, frame("north", 30, fused__depth=depth_to_msg(DEPTH - 9, 30, "north_optical"))),
        (10, frame("north", 10)),
        (20, frame("east", 20)),
        (40, frame("north", 40, labels__image=None)),  # lost on its way
    )
    frames = list(recorded_frames(bag, SITE))
    assert [(f.camera_name, f.stamp_ns) for f in frames] == [("north", 10), ("north", 30), ("east", 20)]
    for found in frames:
        np.testing.assert_array_equal(found.photo, PHOTO)  # compressed or raw
        np.testing.assert_array_equal(found.depth, DEPTH)
        np.testing.assert_array_equal(found.labels, LABELS)
        assert found.camera == CAMERA
        np.testing.assert_allclose(found.pose.rotation, POSE.rotation, atol=1e-12)
    assert frames[0].fused is None
    np.testing.assert_array_equal(frames[1].fused, DEPTH - 9)
