"""depth: traces every pixel of a posed camera to the terrain."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from ltm_core.camera import Camera
from ltm_core.dem import Dem
from ltm_core.pose import Pose
from ltm_core.site_io import load_site
from ltm_core.tracing import TerrainTracer
from ltm_msgs_py.camera_info import camera_to_msg, msg_to_camera
from ltm_msgs_py.image import depth_to_msg, image_to_msg
from ltm_msgs_py.pose import msg_to_pose
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.handler import Handler, NodeConfig, NodeType, Outlet
from ltm_ros.health import Health
from ltm_ros.join import StampJoin
from ltm_ros.node import run_node
from ltm_ros.topics import ALIGNMENT, DEPTH_CAMERA_INFO, DEPTH_IMAGE, POSED_CAMERA_INFO, POSED_POSE


class Depth(Handler[NodeConfig]):
    """Needs no image: calibration and pose decide what the terrain looks like."""

    publications = (DEPTH_IMAGE, DEPTH_CAMERA_INFO, ALIGNMENT)

    def __init__(self, config: NodeConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        site = load_site(config.site)
        site.camera(config.camera)
        dem = site.open_dem()
        self._tracer = TerrainTracer(dem, site.curvature, site.refraction)
        self._frame_id = f"{config.camera}_optical"
        self._join = StampJoin(("info", "pose"), self._trace, health)
        self._warm_up(dem)

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        return {
            POSED_CAMERA_INFO: lambda m: self._join.add("info", stamp_of(m), m),
            POSED_POSE: lambda m: self._join.add("pose", stamp_of(m), m),
        }

    def finish(self) -> None:
        self._join.finish()

    def _trace(self, info: Any, pose: Any) -> None:
        camera, where, stamp = msg_to_camera(info), msg_to_pose(pose, "map"), stamp_of(info)
        ranges = self._tracer.trace(camera, where)
        self.outlet.publish(DEPTH_CAMERA_INFO, camera_to_msg(camera, stamp, self._frame_id))
        self.outlet.publish(DEPTH_IMAGE, depth_to_msg(ranges.depth(), stamp, self._frame_id))
        if self.outlet.wanted(ALIGNMENT):
            self.outlet.publish(ALIGNMENT, image_to_msg(ranges.points(), "32FC3", stamp, "map"))
        for name, count in asdict(self._tracer.statistics).items():
            self.health.gauge(f"tracer.{name}", count)

    def _warm_up(self, dem: Dem) -> None:
        """Compile the kernels now, or load them from numba's cache: the first frame shall not wait for it."""
        summit = np.unravel_index(np.nanargmax(dem.elevation), dem.elevation.shape)
        x, y = dem.geometry.to_map(*summit)
        pose = Pose.from_angles((float(x), float(y), float(dem.elevation[summit]) + 10.0), 0.0)
        for way in ("profile", "pyramid"):
            self._tracer.trace(Camera.from_fov(3, 2, 50.0), pose, way)


NODE = NodeType("depth", NodeConfig, Depth)


def main() -> None:
    run_node(NODE)


if __name__ == "__main__":
    main()
