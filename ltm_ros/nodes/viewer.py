"""viewer: show the running graph in Rerun, live or into an .rrd file."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from ltm_core.base.resources import config_path
from ltm_core.fuel.life_form import life_form_labels
from ltm_core.geometry.range_image import RangeImage
from ltm_core.site.site_io import load_site
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.cells import msg_to_changed
from ltm_msgs_py.grid import msg_to_classes
from ltm_msgs_py.image import msg_to_array, msg_to_depth, msg_to_rgb
from ltm_msgs_py.pose import msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime import topics
from ltm_ros.runtime.handler import NodeConfig, NodeType, Outlet, Topic
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.stamp_join import JoiningHandler, Part, StampJoin
from ltm_ros.runtime.topics import of_camera, of_cameras, of_site
from ltm_ros.viewer import RerunView
from ltm_ros.viewer.server import GRPC_PORT, WEB_PORT

POINT_STEP = 12
"""Step in pixels between the points of a depth image in the 3D view."""


class ViewerConfig(NodeConfig):
    save: str = ""
    """.rrd file to write; empty: none. If it exists, `<name>_1.rrd` and so on is used."""
    serve: bool = False
    """Whether to serve a live view on loopback."""
    web_port: int = Field(WEB_PORT, ge=0, le=65535)
    """Port of the page on loopback; 0: any."""
    grpc_port: int = Field(GRPC_PORT, ge=1, le=65535)
    """Port of the data on loopback."""


class ViewerHandler(JoiningHandler[ViewerConfig]):
    def __init__(self, config: ViewerConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        self._site = load_site(config.site)
        dem = self._site.open_dem()
        save, number = Path(config.save) if config.save else None, 0
        while save is not None and save.exists():
            number += 1
            save = save.with_name(f"{Path(config.save).stem}_{number}{save.suffix}")
        self._view = RerunView(
            f"ltm {self._site.name}",
            self._site,
            dem,
            life_form_labels(LabelSet.load(config_path(self._site.labels))),
            save=save,
            serve=config.serve,
            web_port=config.web_port,
            grpc_port=config.grpc_port,
        )
        self._joins = [join for camera in self._site.cameras for join in self._joins_of(camera)]

    def _joins_of(self, camera: str) -> Iterator[StampJoin]:
        at = partial(of_camera, self._site.name, camera)
        parts = {
            "image": at(topics.POSED_IMAGE),
            "depth": at(topics.DEPTH_IMAGE),
            "info": at(topics.DEPTH_CAMERA_INFO),
            "labels": at(topics.LABELS_IMAGE),
            "pose": at(topics.POSED_POSE),
        }
        yield StampJoin(parts, partial(self._show, camera), self.health, camera=camera)
        if self._site.depth_model:
            fusion = [
                Part("traced", topic=at(topics.DEPTH_IMAGE)),
                Part("fused", topic=at(topics.FUSED_DEPTH)),
                # It is published before the fused depth, and not always.
                Part("network", wait_s=0.0, remembered=2, topic=at(topics.NETWORK_DEPTH)),
            ]
            yield StampJoin(fusion, partial(self._show_fusion, camera), self.health, camera=camera)

    @property
    def subscriptions(self) -> Mapping[Topic, Callable[[Any], None]]:
        taken = {**super().subscriptions, **of_cameras(self._site, {topics.LABELS_HEAT: self.on_heat})}
        view = self._view
        whole: dict[Topic, Callable[[Any], None]] = {
            topics.FUEL_MAP: lambda message: view.log_fuel_map(stamp_of(message), *msg_to_classes(message))
        }
        if self._site.terrain is not None:
            whole[topics.TERRAIN_CHANGE] = lambda message: view.log_change(stamp_of(message), *msg_to_classes(message))
            whole[topics.TERRAIN_UPDATE] = self.on_changed_cells
        return taken | {of_site(self._site.name, topic): take for topic, take in whole.items()}

    def on_heat(self, camera: str, message: Any) -> None:
        self._view.log_heat(camera, stamp_of(message), msg_to_array(message, ("mono8",)))

    def on_changed_cells(self, message: Any) -> None:
        changed, points = msg_to_changed(message)
        cells = np.column_stack([changed.rows, changed.cols])
        self._view.log_changed_cells(stamp_of(message), cells, points, changed.kind)

    def finish(self) -> None:
        try:
            super().finish()
        finally:
            self._view.close()

    def _show_fusion(self, camera: str, traced: Any, fused: Any, network: Any) -> None:
        alone = None if network is None else msg_to_depth(network)
        self._view.log_fusion(camera, stamp_of(fused), msg_to_depth(fused), msg_to_depth(traced), alone)

    def _show(self, camera: str, image: Any, depth: Any, info: Any, labels: Any, pose: Any) -> None:
        stamp, where, model = stamp_of(image), msg_to_pose(pose, "map"), msg_to_camera(info)
        rgb, metres, classes = msg_to_rgb(image), msg_to_depth(depth), msg_to_array(labels, ("mono8",))
        self._view.log_pose(camera, stamp, where, model)
        self._view.log_image(camera, stamp, rgb)
        self._view.log_depth(camera, stamp, metres, model)
        self._view.log_labels(camera, stamp, classes)
        every = slice(None, None, POINT_STEP)
        sparse = RangeImage.from_depth(metres[every, every], model.scaled(POINT_STEP), where, self._site.bend)
        points = sparse.points().reshape(-1, 3)
        seen = points[:, 2] == points[:, 2]
        self._view.log_points(camera, stamp, points[seen], rgb[every, every].reshape(-1, 3)[seen])


NODE = NodeType("viewer", ViewerConfig, ViewerHandler)
run_node(NODE, __name__)
