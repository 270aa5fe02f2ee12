"""depth: traces every pixel of a posed camera to the terrain and publishes the depth image."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from ltm_core.camera import Camera
from ltm_core.dem import Dem
from ltm_core.frame_steps import TracingConfig, TracingStep, seen
from ltm_core.grid import GridGeometry
from ltm_core.pose import Pose
from ltm_core.site_io import load_site
from ltm_core.tracing import TerrainTracer
from ltm_msgs_py.camera_info import camera_to_msg, msg_to_camera
from ltm_msgs_py.image import depth_to_msg, image_to_msg
from ltm_msgs_py.pose import msg_to_pose
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime.handler import Handler, NodeType, Outlet
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.stamp_join import JoinConfig, StampJoin
from ltm_ros.runtime.topics import (
    ALIGNMENT,
    DEPTH_CAMERA_INFO,
    DEPTH_IMAGE,
    FINISHED,
    GROUND_DEPTH,
    POSED_CAMERA_INFO,
    POSED_POSE,
)


class DepthConfig(JoinConfig, TracingConfig):
    """Parameters of the node: how it joins, and how it traces."""


class Depth(Handler[DepthConfig]):
    """Needs no image: calibration and pose decide what the terrain looks like."""

    publications = (DEPTH_IMAGE, DEPTH_CAMERA_INFO, GROUND_DEPTH, ALIGNMENT)
    acknowledgements = (FINISHED,)

    def __init__(self, config: DepthConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        site = load_site(config.site)
        self._step = TracingStep(site, config.camera, config)
        self._most_pixels = site.limits.pixels
        self._frame_id = f"{config.camera}_optical"
        self._join = StampJoin(("info", "pose"), self._trace, health, max_wait=config.max_wait)
        _compile_kernels()

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        return {
            POSED_CAMERA_INFO: lambda m: self._join.add("info", stamp_of(m), m),
            POSED_POSE: lambda m: self._join.add("pose", stamp_of(m), m),
        }

    def discard(self, stamp_ns: int) -> None:
        self._join.discard(stamp_ns)

    def tick(self, waited: float) -> None:
        self._join.tick(waited)

    def finish(self) -> None:
        self._join.finish()

    def _trace(self, info: Any, pose: Any) -> None:
        camera, where, stamp = msg_to_camera(info), msg_to_pose(pose, "map"), stamp_of(info)
        if camera.width * camera.height > self._most_pixels:
            self.health.drop(
                "too_large",
                f"calibration of {camera.width} x {camera.height} pixels, at most {self._most_pixels} are traced; "
                "raise pixels under `limits:` in the site file",
            )
            return
        hidden = self._step.hidden(camera)
        ranges = self._step.trace(camera, where)
        self.outlet.publish(DEPTH_CAMERA_INFO, camera_to_msg(camera, stamp, self._frame_id))
        self.outlet.provide(
            DEPTH_IMAGE, stamp, lambda: depth_to_msg(seen(ranges.depth(), hidden), stamp, self._frame_id)
        )
        if self.outlet.wanted(GROUND_DEPTH):
            bare = self._step.trace_bare_earth(camera, where, ranges)
            self.outlet.publish(GROUND_DEPTH, depth_to_msg(seen(bare.depth(), hidden), stamp, self._frame_id))
        if self.outlet.wanted(ALIGNMENT):
            self.outlet.publish(ALIGNMENT, image_to_msg(seen(ranges.points(), hidden), "32FC3", stamp, "map"))
        for name, count in asdict(self._step.tracer.statistics).items():
            self.health.gauge(f"tracer.{name}", count)
        self.outlet.acknowledge(FINISHED, stamp)


def _compile_kernels() -> None:
    """Now, or load them from numba's cache: the first frame shall not wait for it."""
    plain = Dem(np.zeros((9, 12), np.float32), GridGeometry(0.0, 9.0, 1.0, 12, 9))
    pose = Pose.from_angles((6.3, 4.4, 10.0), 0.0, -20.0)
    for way in ("profile", "pyramid"):
        TerrainTracer(plain).trace(Camera.from_fov(3, 2, 50.0), pose, way)


NODE = NodeType("depth", DepthConfig, Depth)


def main() -> None:
    run_node(NODE)


if __name__ == "__main__":
    main()
