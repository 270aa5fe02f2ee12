"""depth: trace every pixel of a posed camera to the terrain and publish the depth image."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from ltm_core.pipeline.frame_steps import TracingConfig, TracingStep, seen
from ltm_core.pipeline.kernels import compile_kernels
from ltm_core.site.site_io import load_site
from ltm_msgs_py.cells import traced_to_msg
from ltm_msgs_py.image import depth_to_msg, image_to_msg
from ltm_msgs_py.pose import msg_to_pose
from ltm_msgs_py.sensors import camera_to_msg, msg_to_camera
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.fuel_map.surface_confirmation import SurfaceFollower
from ltm_ros.runtime import topics
from ltm_ros.runtime.handler import NodeType, Outlet, Topic
from ltm_ros.runtime.health import Health, too_many_pixels
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.stamp_join import JoinConfig, JoiningHandler, StampJoin
from ltm_ros.runtime.topics import of_site


class DepthConfig(JoinConfig, TracingConfig):
    """Parameters of the node: joining and tracing."""

    surfaces: str = ""
    """Folder of the confirmed surfaces to trace to; empty: the site's rasters are used. The graph sets it."""


class DepthHandler(JoiningHandler[DepthConfig]):
    """Traces the terrain for each calibration and pose; uses no image."""

    publications: Sequence[Topic] = (
        topics.DEPTH_IMAGE,
        topics.DEPTH_CAMERA_INFO,
        topics.GROUND_DEPTH,
        topics.ALIGNMENT,
    )

    def __init__(self, config: DepthConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        site = load_site(config.site)
        self._step = TracingStep(site, config.camera, config)
        self._surface = of_site(site.name, topics.TERRAIN_SURFACE)
        self._follower = SurfaceFollower(site, config.surfaces, self._step.trace_to, health)
        if config.surfaces:
            self.publications = (*self.publications, topics.DEPTH_INFO)
        self._most_pixels = site.limits.pixels
        self._frame_id = f"{config.camera}_optical"
        parts = {"info": topics.POSED_CAMERA_INFO, "pose": topics.POSED_POSE}
        self._joins = [StampJoin(parts, self._trace, health, max_wait=config.max_wait)]
        compile_kernels("depth", site)

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        follower = {self._surface: self._follower.on_message} if self.config.surfaces else {}
        return {**super().subscriptions, **follower}

    def tick(self, waited: float) -> None:
        super().tick(waited)
        self._follower.tick()

    def _trace(self, info: Any, pose: Any) -> None:
        camera, where, stamp = msg_to_camera(info), msg_to_pose(pose, "map"), stamp_of(info)
        if too_many_pixels(self.health, "calibration", camera.width, camera.height, self._most_pixels):
            return
        hidden = self._step.hidden(camera, where)
        traced = self._step.trace(camera, where)
        ranges, version = traced.ranges, traced.over.version
        if version != self._step.over.version:
            self.health.note("below_confirmed_surface")
        self.outlet.publish(topics.DEPTH_CAMERA_INFO, camera_to_msg(camera, stamp, self._frame_id))
        self.outlet.provide(
            topics.DEPTH_IMAGE, stamp, lambda: depth_to_msg(seen(ranges.depth(), hidden), stamp, self._frame_id)
        )
        if self.outlet.wanted(topics.GROUND_DEPTH):
            bare = traced.bare_earth().depth()
            self.outlet.publish(topics.GROUND_DEPTH, depth_to_msg(seen(bare, hidden), stamp, self._frame_id))
        if self.outlet.wanted(topics.ALIGNMENT):
            self.outlet.publish(topics.ALIGNMENT, image_to_msg(seen(ranges.points(), hidden), "32FC3", stamp, "map"))
        if self.config.surfaces:
            self.outlet.provide(topics.DEPTH_INFO, stamp, lambda: traced_to_msg(self.config.camera, stamp, version))
        for name, count in asdict(self._step.over.tracer.statistics).items():
            self.health.gauge(f"tracer.{name}", count)


NODE = NodeType("depth", DepthConfig, DepthHandler)
run_node(NODE, __name__)
