"""topodepth: fuse traced depth with the depth that a network estimates from the image (TopoDepth)."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import Field

from ltm_core.base.errors import ConfigError
from ltm_core.depth.topodepth import FusedDepth, FusionOutcome, FusionVerdict
from ltm_core.pipeline.frame import PosedImage
from ltm_core.pipeline.fusing_step import FusedFrame, FusingConfig, FusingStep
from ltm_core.pipeline.kernels import compile_kernels
from ltm_core.pipeline.site_surface import confirmed_terrain, surface_versions
from ltm_core.site.site_io import load_site
from ltm_core.surface.confirmed_surface import AS_GIVEN
from ltm_msgs_py.cells import msg_to_version
from ltm_msgs_py.image import depth_to_msg, image_to_msg, msg_to_array, msg_to_depth, msg_to_rgb
from ltm_msgs_py.pose import msg_to_covariance, msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_msgs_py.stamp import stamp_of
from ltm_msgs_py.status import status_to_msg
from ltm_ros.runtime import topics
from ltm_ros.runtime.handler import NodeType, Outlet
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.stamp_join import JoinConfig, JoiningHandler, Part, StampJoin

STATED_EVERY_NS = 60 * 10**9
"""Maximum age of the network's verdict in the status, in the time of the frames."""


class TopoDepthConfig(JoinConfig, FusingConfig):
    """Parameters of the node: joining and fusion."""

    label_wait: float = Field(5.0, ge=0)
    """Seconds for which a frame waits for its labels before it is fused without them; on a tower's two cores they may
    be several seconds late."""
    max_waiting: int = Field(4, ge=1)
    """Maximum number of frames that wait for labels."""
    surfaces: str = ""
    """Folder of the confirmed surfaces that `depth` traces to; empty: it traces to the site's rasters. The graph sets
    it."""


class TopoDepthHandler(JoiningHandler[TopoDepthConfig]):
    """Joins image, calibration, pose and traced depth, and labels if they come in time."""

    publications = (
        *(topics.FUSED_DEPTH, topics.FUSED_SIGMA, topics.FUSED_SOURCE, topics.FUSED_INFO),
        *(topics.MEASURED_DEPTH, topics.MEASURED_SIGMA, topics.NETWORK_DEPTH),
    )

    def __init__(self, config: TopoDepthConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        site = load_site(config.site)
        try:
            self._step = FusingStep(site, config.camera, config)
        except ConfigError as error:
            raise ConfigError(f"{config.site}: {error}") from error
        self._site = site
        self._versions = surface_versions(site, Path(config.surfaces)) if config.surfaces else None
        self._version = AS_GIVEN
        parts = [
            Part("image", topic=topics.POSED_IMAGE),
            Part("info", topic=topics.POSED_CAMERA_INFO),
            Part("pose", topic=topics.POSED_POSE),
            Part("depth", topic=topics.DEPTH_IMAGE),
            *([Part("traced", topic=topics.DEPTH_INFO)] if config.surfaces else []),
            Part("labels", wait_s=config.label_wait, remembered=2 * config.max_waiting, topic=topics.LABELS_IMAGE),
        ]
        join = StampJoin(parts, self._fuse, health, whole_capacity=config.max_waiting, max_wait=config.max_wait)
        self._joins = [join]
        self._frame_id = f"{config.camera}_optical"
        self._stated_ns = -STATED_EVERY_NS
        compile_kernels("topodepth", site)

    def _fuse(self, image: Any, info: Any, pose: Any, depth: Any, labels: Any, traced: Any = None) -> None:
        """Fuse a frame. `traced`: states the version of the surface that it was traced to."""
        version = AS_GIVEN if traced is None else msg_to_version(traced)
        if self._versions is not None and version != self._version:
            over = confirmed_terrain(self._site, self._versions, version)
            self._step.trace_to(None if over.top is over.ground else over.ground)
            self._version = version
        if labels is None:
            self.health.note("unlabelled")
        stamp, where = stamp_of(image), msg_to_pose(pose, "map")

        @cache
        def found() -> FusedFrame:
            fused = self._step.fuse(
                msg_to_depth(depth),
                PosedImage(msg_to_rgb(image), msg_to_camera(info), where, stamp, self.config.camera),
                None if labels is None else msg_to_array(labels, ("mono8",)),
                msg_to_covariance(pose),
            )
            if fused.trouble:
                self.health.drop("network", fused.trouble)
            return fused

        self._publish(found, stamp)
        fused_anyway = found.cache_info().currsize > 0
        if fused_anyway or not 0 <= stamp - self._stated_ns < STATED_EVERY_NS:
            outcome = found().fusion.outcome
            self._state(outcome)
            self._stated_ns = stamp if outcome.verdict is FusionVerdict.OK else -STATED_EVERY_NS

    def _publish(self, found: Callable[[], FusedFrame], stamp: int) -> None:
        """Publish what has subscribers. A frame without any is fused only for the status, from time to time."""
        frame = self._frame_id
        measured = cache(lambda: found().fusion.outcome.measured(found().view.doubtful))
        fused = cache(lambda: found().fusion.fused)
        self.outlet.provide(topics.FUSED_INFO, stamp, lambda: self._info(fused(), stamp))
        if self.outlet.wanted(topics.NETWORK_DEPTH) and (metres := found().fusion.outcome.network_depth()) is not None:
            self.outlet.publish(topics.NETWORK_DEPTH, depth_to_msg(metres, stamp, frame))
        self.outlet.provide(topics.MEASURED_SIGMA, stamp, lambda: depth_to_msg(measured().sigma, stamp, frame))
        self.outlet.provide(topics.MEASURED_DEPTH, stamp, lambda: depth_to_msg(measured().depth, stamp, frame))
        self.outlet.provide(topics.FUSED_SIGMA, stamp, lambda: depth_to_msg(fused().sigma, stamp, frame))
        self.outlet.provide(topics.FUSED_SOURCE, stamp, lambda: image_to_msg(fused().source, "mono8", stamp, frame))
        self.outlet.provide(topics.FUSED_DEPTH, stamp, lambda: depth_to_msg(fused().depth, stamp, frame))

    def _info(self, fused: FusedDepth, stamp: int) -> Any:
        wrong = fused.verdict is not FusionVerdict.OK
        return status_to_msg(f"{self.config.camera}/fused", stamp, fused.info(), fused.reason, wrong)

    def _state(self, outcome: FusionOutcome) -> None:
        self.health.note(f"verdict.{outcome.verdict.value}")
        if outcome.verdict is not FusionVerdict.OK:
            self.health.gauge("last_verdict", f"{outcome.verdict.value}: {outcome.reason}")
        self.health.gauge("verdict", outcome.verdict.value)
        self.health.gauge("inlier_ratio", f"{outcome.inlier_ratio:.3f}")


NODE = NodeType("topodepth", TopoDepthConfig, TopoDepthHandler)
run_node(NODE, __name__)
