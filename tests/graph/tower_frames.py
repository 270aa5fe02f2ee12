"""Frames of a small site's tower, sent as a driver would send them now."""

import time

from bystander import Bystander
from scenes.small_site import NAME, SmallSite

from ltm_msgs_py.image import compressed_to_msg, encode_rgb
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.runtime.topics import CAMERA_INFO, IMAGE_COMPRESSED, POSE, camera_topic

TOPICS = (CAMERA_INFO, POSE, IMAGE_COMPRESSED)


def send_frame(bystander: Bystander, site: SmallSite) -> int:
    """One frame of the tower, taken now, on TOPICS that are open; its stamp."""
    stamp = time.time_ns()
    (frame,) = [f for f in site.frames(1) if f.camera_name == "tower"]
    messages = (
        camera_to_msg(frame.camera, stamp, "tower_optical"),
        pose_to_msg(frame.pose, stamp),
        compressed_to_msg(encode_rgb(site.photo(frame), quality=95), "jpeg", stamp, "tower_optical"),
    )
    for topic, message in zip(TOPICS, messages, strict=True):
        bystander.send(camera_topic(NAME, "tower", topic), message)
    return stamp
