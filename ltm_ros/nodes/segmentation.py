"""segmentation: labels every pixel of a camera's images with its class of cover (grass, shrub, tree, sky, ...)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from pydantic import Field

from ltm_core.resources import config_path
from ltm_core.site_io import load_site
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.scene_view import SceneFilter
from ltm_core.vision.segmenter import Segmentation as Labels
from ltm_core.vision.segmenter import Segmenter
from ltm_msgs_py.image import image_to_msg, msg_to_rgb
from ltm_msgs_py.label_info import label_set_to_msg
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime.handler import Handler, NodeConfig, NodeType, Outlet
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.picture_health import note_picture
from ltm_ros.runtime.topics import FINISHED, LABELS_CONFIDENCE, LABELS_IMAGE, LABELS_INFO, POSED_IMAGE


class SegmentationConfig(NodeConfig):
    model: str = ""
    """Manifest name or path; empty: the site's."""
    threads: int = Field(1, ge=1)
    """Cores that the network may use."""
    zoom: float = Field(1.0, ge=1, le=4)
    """Above 1: look a second time at the slopes along the skyline, so much larger; costs one to several more runs."""
    confidence: float | None = Field(None, ge=0, lt=1)
    """Labels of lower probability are withdrawn; None: as the network's manifest or the camera's head says."""
    tree_contrast: float | None = Field(None, ge=0)
    """*tree* is withdrawn where the photo's local contrast is lower (8-bit steps): hazy far slopes are called so."""


class Segmentation(Handler[SegmentationConfig]):
    publications = (LABELS_IMAGE, LABELS_CONFIDENCE, LABELS_INFO)
    acknowledgements = (FINISHED,)

    def __init__(self, config: SegmentationConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        site = load_site(config.site)
        self._scene = SceneFilter.of(site, config.camera)
        self._labels = LabelSet.load(config_path(site.labels))
        self._segmenter = Segmenter.of(site, config.camera, config.model, config.threads)
        chosen = {"confidence": config.confidence, "tree_contrast": config.tree_contrast}
        given = {name: value for name, value in chosen.items() if value is not None}
        self._segmenter.withdrawal = self._segmenter.withdrawal.model_copy(update=given)

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        return {POSED_IMAGE: self.on_image}

    def start(self) -> None:
        self.outlet.publish(LABELS_INFO, label_set_to_msg(self._labels, self._segmenter.described))

    def on_image(self, message: Any) -> None:
        stamp, frame_id = stamp_of(message), message.header.frame_id
        photo = msg_to_rgb(message)
        seen = self._scene.look(photo)
        note_picture(self.health, seen)
        if seen.reason is None:
            found = self._segmenter.segment(photo, self.config.zoom)
        else:
            found = Labels(np.zeros(photo.shape[:2], np.uint8), np.zeros(photo.shape[:2], np.uint8))
        seen.unlabelled(found.labels, found.confidence)
        for topic, image in ((LABELS_CONFIDENCE, found.confidence), (LABELS_IMAGE, found.labels)):
            self.outlet.provide(topic, stamp, partial(image_to_msg, image, "mono8", stamp, frame_id))
        self.outlet.acknowledge(FINISHED, stamp)


NODE = NodeType("segmentation", SegmentationConfig, Segmentation)


def main() -> None:
    run_node(NODE)


if __name__ == "__main__":
    main()
