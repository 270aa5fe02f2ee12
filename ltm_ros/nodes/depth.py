"""depth: traces every pixel of a posed camera to the terrain and publishes the depth image."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ltm_core.camera import Camera
from ltm_core.confirmed_terrain import ConfirmedTerrain
from ltm_core.dem import Dem
from ltm_core.errors import PoseError
from ltm_core.grid import GridGeometry
from ltm_core.pose import Pose
from ltm_core.range_image import RangeImage
from ltm_core.raster.surface_versions_io import AS_GIVEN
from ltm_core.site_io import load_site
from ltm_core.tracing import TerrainTracer
from ltm_core.types import BoolArray, Float32Array
from ltm_core.vision.scene_view import SceneFilter
from ltm_msgs_py.camera_info import camera_to_msg, msg_to_camera
from ltm_msgs_py.confirmed_surface import traced_to_msg
from ltm_msgs_py.image import depth_to_msg, image_to_msg
from ltm_msgs_py.pose import msg_to_pose
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.confirmed_surface.follower import SurfaceFollower
from ltm_ros.runtime.handler import Handler, NodeType, Outlet, Topic
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.stamp_join import JoinConfig, StampJoin
from ltm_ros.runtime.topics import (
    ALIGNMENT,
    DEPTH_CAMERA_INFO,
    DEPTH_IMAGE,
    DEPTH_INFO,
    FINISHED,
    GROUND_DEPTH,
    POSED_CAMERA_INFO,
    POSED_POSE,
    TERRAIN_SURFACE,
    site_topic,
)


class DepthConfig(JoinConfig):
    surface: bool = True
    """Trace to the tops of trees and houses where the site has a surface raster; else, and where not, to bare earth.
    Both hits are kept: the one on bare earth is then on `depth/ground`, while someone listens."""
    surfaces: str = ""
    """Folder of the confirmed surfaces that are traced to; empty: the site's rasters are. The graph gives it."""


@dataclass(frozen=True, eq=False)
class _Traced:
    """`version`: of the confirmed surface. `bare`: the same tracer where nothing stands on bare earth."""

    version: str
    tracer: TerrainTracer
    bare: TerrainTracer


class Depth(Handler[DepthConfig]):
    """Needs no image: calibration and pose decide what the terrain looks like."""

    publications: Sequence[Topic] = (DEPTH_IMAGE, DEPTH_CAMERA_INFO, GROUND_DEPTH, ALIGNMENT)
    acknowledgements = (FINISHED,)

    def __init__(self, config: DepthConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        site = load_site(config.site)
        self._scene = SceneFilter.of(site, config.camera)
        self._site = site
        self._given: _Traced | None = None
        self._follower = SurfaceFollower(site, config.surfaces, self._trace_to, health)
        if config.surfaces:
            self.publications = (*self.publications, DEPTH_INFO)
        self._most_pixels = site.limits.pixels
        self._frame_id = f"{config.camera}_optical"
        self._join = StampJoin(("info", "pose"), self._trace, health, max_wait=config.max_wait)
        _compile_kernels()

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        found: dict[Any, Callable[[Any], None]] = {
            POSED_CAMERA_INFO: lambda m: self._join.add("info", stamp_of(m), m),
            POSED_POSE: lambda m: self._join.add("pose", stamp_of(m), m),
        }
        if self.config.surfaces:
            found[replace(TERRAIN_SURFACE, name=site_topic(self._site.name, TERRAIN_SURFACE))] = (
                self._follower.on_message
            )
        return found

    def _trace_to(self, terrain: ConfirmedTerrain) -> None:
        """All of it is made beside the former, whose place it takes at once."""
        self._traced = self._traced_over(terrain)

    def _traced_over(self, terrain: ConfirmedTerrain) -> _Traced:
        site = self._site
        top = terrain.top if self.config.surface else terrain.ground
        rays = site.curvature, site.refraction, site.possible_ground
        tracer = TerrainTracer(top, *rays)
        bare = tracer if top is terrain.ground else TerrainTracer(terrain.ground, *rays)
        return _Traced(terrain.name, tracer, bare)

    def _ranges(self, camera: Camera, pose: Pose) -> tuple[_Traced, RangeImage]:
        """What has grown about a mast shall not end its depth: such a frame is traced to the terrain as given."""
        traced = self._traced
        try:
            return traced, traced.tracer.trace(camera, pose)
        except PoseError:
            if traced.version == AS_GIVEN:
                raise
        if self._given is None:
            self._given = self._traced_over(ConfirmedTerrain.as_given(self._site))
        ranges = self._given.tracer.trace(camera, pose)
        self.health.note("below_confirmed_surface")
        return self._given, ranges

    def discard(self, stamp_ns: int) -> None:
        self._join.discard(stamp_ns)

    def tick(self, waited: float) -> None:
        self._join.tick(waited)
        self._follower.tick()

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
        hidden = self._scene.hidden(camera.width, camera.height)
        traced, ranges = self._ranges(camera, where)
        self.outlet.publish(DEPTH_CAMERA_INFO, camera_to_msg(camera, stamp, self._frame_id))
        self.outlet.provide(
            DEPTH_IMAGE, stamp, lambda: depth_to_msg(_seen(ranges.depth(), hidden), stamp, self._frame_id)
        )
        if self.outlet.wanted(GROUND_DEPTH):
            bare = ranges if traced.bare is traced.tracer else traced.bare.trace(camera, where)
            self.outlet.publish(GROUND_DEPTH, depth_to_msg(_seen(bare.depth(), hidden), stamp, self._frame_id))
        if self.outlet.wanted(ALIGNMENT):
            self.outlet.publish(ALIGNMENT, image_to_msg(_seen(ranges.points(), hidden), "32FC3", stamp, "map"))
        if self.config.surfaces:
            self.outlet.provide(DEPTH_INFO, stamp, lambda: traced_to_msg(self.config.camera, stamp, traced.version))
        for name, count in asdict(traced.tracer.statistics).items():
            self.health.gauge(f"tracer.{name}", count)
        self.outlet.acknowledge(FINISHED, stamp)


def _seen(values: Float32Array, hidden: BoolArray | None) -> Float32Array:
    """Depths (H, W) or points (H, W, 3), unknown where the camera's mask has it that something else is seen."""
    if hidden is None:
        return values
    seen = values.copy()
    seen[hidden] = np.nan
    return seen


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
