"""A recording over two days of a block that stands in view since the DEM was made, in colours of depth."""

from __future__ import annotations

from pathlib import Path

from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import compressed_to_msg, encode_rgb, image_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.runtime.topics import CAMERA_INFO, IMAGE_COMPRESSED, IMAGE_RAW, POSE, camera_topic
from scenes.small_site import BEGIN_NS, MAST, NAME, TOWER, SmallSite
from scenes.terrain_frames import HOUR, built_up, mast_pose, photo_of_depth

FIRST_HOURS, NEXT_HOURS = (-8, -6, -4, -2), (10, 12)
"""From `BEGIN_NS`, 22:13 UTC, on: four looks of the mast on its day, and two on the next one."""
TOWER_HOURS = (-7, 11)
LOOKS = len(FIRST_HOURS) + len(NEXT_HOURS)


def write_block_recording(small: SmallSite, path: Path) -> Path:
    """Of a site of `write_fusing_site`: `LOOKS` frames of the mast, and as many of the tower as `TOWER_HOURS` says."""
    surface, standing = built_up(small), mast_pose(small)
    photo = photo_of_depth(surface, MAST, standing)
    frames = sorted([(h, "mast") for h in (*FIRST_HOURS, *NEXT_HOURS)] + [(h, "tower") for h in TOWER_HOURS])
    with BagWriter(path) as bag:
        for hours, camera in frames:
            stamp = BEGIN_NS + hours * HOUR
            if camera == "mast":
                bag.write(camera_topic(NAME, camera, IMAGE_RAW), image_to_msg(photo, "rgb8", stamp, "mast"), stamp)
                continue
            pose = small.tower_pose(20.0 + hours)
            picture = encode_rgb(photo_of_depth(surface, TOWER, pose), quality=95)
            for topic, message in (
                (CAMERA_INFO, camera_to_msg(TOWER, stamp, "tower_optical")),
                (POSE, pose_to_msg(pose, stamp)),
                (IMAGE_COMPRESSED, compressed_to_msg(picture, "jpeg", stamp, "tower_optical")),
            ):
                bag.write(camera_topic(NAME, camera, topic), message, stamp)
    return path
