"""segmentation: label every pixel of a camera's images with its land cover class (grass, shrub, tree, sky, ...)."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from ltm_core.base.resources import config_path
from ltm_core.pipeline.frame import PosedImage
from ltm_core.pipeline.frame_steps import LabellingConfig, LabellingStep
from ltm_core.site.site_io import load_site
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.image import image_to_msg, msg_to_rgb
from ltm_msgs_py.json_topics import label_set_to_msg
from ltm_msgs_py.pose import msg_to_covariance, msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime import topics
from ltm_ros.runtime.handler import NodeType, Outlet
from ltm_ros.runtime.health import Health, note_picture
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.stamp_join import JoinConfig, JoiningHandler, StampJoin
from ltm_ros.runtime.topics import of_site


class SegmentationConfig(JoinConfig, LabellingConfig):
    """Parameters of the node: camera, network, and how images are joined with their poses."""


class SegmentationHandler(JoiningHandler[SegmentationConfig]):
    """Labels images, with what the terrain excludes at their poses."""

    publications = (topics.LABELS_IMAGE, topics.LABELS_CONFIDENCE, topics.LABELS_HEAT, topics.LABELS_INFO)

    def __init__(self, config: SegmentationConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        site = self._site = load_site(config.site)
        self._labels = LabelSet.load(config_path(site.labels))
        self._step = LabellingStep(site, config.camera, config)
        self._assumed = site.assumed_pose_error.covariance()
        parts = {"image": topics.POSED_IMAGE, "info": topics.POSED_CAMERA_INFO, "pose": topics.POSED_POSE}
        self._joins = [StampJoin(parts, self._label, health, max_wait=config.max_wait)]

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        return {**super().subscriptions, of_site(self._site.name, topics.PROMPT): self.on_prompt}

    def start(self) -> None:
        step = self._step
        self.outlet.publish(
            topics.LABELS_INFO, label_set_to_msg(self._labels, step.segmenter.described, step.reliability)
        )
        self.health.gauge("labels", step.reliability)

    def on_prompt(self, message: Any) -> None:
        """Show where the images show a prompt, from the next one on."""
        self._step.show(message.data)
        self.health.gauge("prompt", message.data or "none")

    def _label(self, image: Any, info: Any, pose: Any) -> None:
        stamp, frame_id = stamp_of(image), image.header.frame_id
        photo, camera = msg_to_rgb(image), self.config.camera
        frame = PosedImage(photo, msg_to_camera(info), msg_to_pose(pose, "map"), stamp, camera)
        found, view = self._step.label(frame, msg_to_covariance(pose, self._assumed))
        note_picture(self.health, view)
        for topic, values in ((topics.LABELS_CONFIDENCE, found.confidence), (topics.LABELS_IMAGE, found.labels)):
            self.outlet.provide(topic, stamp, partial(image_to_msg, values, "mono8", stamp, frame_id))
        if self.outlet.wanted(topics.LABELS_HEAT) and (heat := self._step.heat(photo, view)) is not None:
            self.outlet.publish(topics.LABELS_HEAT, image_to_msg(heat, "mono8", stamp, frame_id))


NODE = NodeType("segmentation", SegmentationConfig, SegmentationHandler)
run_node(NODE, __name__)
