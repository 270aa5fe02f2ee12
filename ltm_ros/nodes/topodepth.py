"""topodepth: fuses traced depth with the depth that a network estimates from the photo (TopoDepth of the paper)."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field
from std_msgs.msg import String

from ltm_core.camera import Camera
from ltm_core.confirmed_terrain import ConfirmedTerrain, surface_versions
from ltm_core.dem import Dem
from ltm_core.depth.class_priors import ClassPriors
from ltm_core.depth.monocular import DepthNetwork, NetworkDepth
from ltm_core.depth.topodepth import FusedDepth, FusionSettings, Verdict, fuse
from ltm_core.errors import ConfigError, ModelError
from ltm_core.pose import Pose
from ltm_core.range_image import DepthImage, RangeImage
from ltm_core.raster.surface_versions_io import AS_GIVEN
from ltm_core.resources import config_path
from ltm_core.site_io import load_site
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.manifest import Manifest
from ltm_core.vision.scene_view import SceneFilter, SceneView
from ltm_core.vision.view_masks import Looking
from ltm_msgs_py.camera_info import msg_to_camera
from ltm_msgs_py.confirmed_surface import msg_to_traced
from ltm_msgs_py.image import depth_to_msg, image_to_msg, msg_to_array, msg_to_depth, msg_to_rgb
from ltm_msgs_py.pose import msg_to_covariance, msg_to_pose
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime.handler import Handler, NodeType, Outlet
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.stamp_join import JoinConfig, Part, StampJoin
from ltm_ros.runtime.topics import (
    DEPTH_IMAGE,
    DEPTH_INFO,
    FINISHED,
    FUSED_DEPTH,
    FUSED_INFO,
    FUSED_SIGMA,
    FUSED_SOURCE,
    LABELS_IMAGE,
    MEASURED_DEPTH,
    MEASURED_SIGMA,
    NETWORK_DEPTH,
    POSED_CAMERA_INFO,
    POSED_IMAGE,
    POSED_POSE,
)


class TopoDepthConfig(JoinConfig):
    model: str = ""
    """Manifest name or path of a depth network; empty: the site's `depth_model`."""
    label_model: str = ""
    """Manifest name or path of the network that makes the labels, which says how fine they are; empty: the site's
    `model`."""
    threads: int = Field(1, ge=1)
    """Cores that the network may use."""
    label_wait: float = Field(5.0, ge=0)
    """Seconds that a frame waits for its labels before it is fused without them: on a tower's two cores, all nodes of
    all cameras at work, they may be some behind."""
    max_waiting: int = Field(4, ge=1)
    """Frames that wait for labels at most."""
    angle_sigma_deg: float = Field(0.03, ge=0)
    """Standard deviation of a camera's direction, beside what its pose's covariance says."""
    dem_sigma: float = Field(1.0, ge=0)
    """Standard deviation of the terrain's heights, metres."""
    surfaces: str = ""
    """Folder of the confirmed surfaces that `depth` traces to; empty: it traces to the site's rasters. The graph gives
    it."""


class TopoDepth(Handler[TopoDepthConfig]):
    """Joins photo, calibration, pose and traced depth; labels too, where they come in time."""

    publications = (
        FUSED_DEPTH, FUSED_SIGMA, FUSED_SOURCE, FUSED_INFO, MEASURED_DEPTH, MEASURED_SIGMA, NETWORK_DEPTH,
    )  # fmt: skip
    acknowledgements = (FINISHED,)

    def __init__(self, config: TopoDepthConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        site = load_site(config.site)
        model = config.model or site.depth_model
        if not model:
            raise ConfigError(f"{config.site}: no depth network; give `depth_model` a manifest's name or path")
        self._scene = SceneFilter.of(site, config.camera)
        self._label_columns = _label_columns(config.label_model or site.model)
        self._network = DepthNetwork.open(model, config.threads)
        self._config = self._network.fusion
        self._classes = ClassPriors.of(LabelSet.load(config_path(site.labels)), self._config)
        self._site = site
        self._versions = surface_versions(site, Path(config.surfaces)) if config.surfaces else None
        # Bare earth is asked for only where depth is traced to something else.
        self._trace_to(AS_GIVEN, None if site.surface is None else site.open_dem())
        labels = Part("labels", wait_s=config.label_wait, remembered=2 * config.max_waiting)
        parts: list[Part | str] = ["image", "info", "pose", "depth", *(["traced"] if config.surfaces else []), labels]
        self._join = StampJoin(parts, self._fuse, health, whole_capacity=config.max_waiting, max_wait=config.max_wait)
        self._frame_id = f"{config.camera}_optical"
        self._compile_kernels()

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        found: dict[Any, Callable[[Any], None]] = {
            POSED_IMAGE: lambda m: self._join.add("image", stamp_of(m), m),
            POSED_CAMERA_INFO: lambda m: self._join.add("info", stamp_of(m), m),
            POSED_POSE: lambda m: self._join.add("pose", stamp_of(m), m),
            DEPTH_IMAGE: lambda m: self._join.add("depth", stamp_of(m), m),
            LABELS_IMAGE: lambda m: self._join.add("labels", stamp_of(m), m),
        }
        if self.config.surfaces:
            found[DEPTH_INFO] = lambda m: self._join.add("traced", *msg_to_traced(m))
        return found

    def _trace_to(self, version: str, ground: Dem | None) -> None:
        """`ground`: bare earth where depth is traced to what stands on it, which is then traced here besides."""
        rays = self._site.curvature, self._site.refraction, self._site.possible_ground
        self._version, self._ground = version, None if ground is None else TerrainTracer(ground, *rays)

    def discard(self, stamp_ns: int) -> None:
        self._join.discard(stamp_ns)

    def tick(self, waited: float) -> None:
        self._join.tick(waited)

    def finish(self) -> None:
        self._join.finish()

    def _fuse(self, image: Any, info: Any, pose: Any, depth: Any, labels: Any, traced: str = AS_GIVEN) -> None:
        """`traced`: the version of the surface to which the frame was traced."""
        if self._versions is not None and traced != self._version:
            over = ConfirmedTerrain.of(self._site, self._versions, traced)
            self._trace_to(traced, None if over.top is over.ground else over.ground)
        if labels is None:
            self.health.note("unlabelled")
        camera, where = msg_to_camera(info), msg_to_pose(pose, "map")
        stamp, rgb = stamp_of(image), msg_to_rgb(image)
        seen = self._scene.look(rgb, Looking.of(camera, where))
        ground: RangeImage | DepthImage = DepthImage(msg_to_depth(depth), camera, where)
        surface = None
        if self._ground is not None:
            ground, surface = self._ground.trace(camera, where), ground
        network = None
        try:
            network = self._network.predict(rgb, camera) if seen.reason is None else None
        except ModelError as error:
            # The terrain's depth is worth having without a network.
            self.health.drop("network", str(error))
        fused = fuse(
            ground,
            network,
            rgb,
            None if labels is None else msg_to_array(labels, ("mono8",)),
            self._classes,
            self._settings(pose),
            surface,
            self._config,
            seen.hidden,
            seen.unusable,
        )
        self._publish(fused, stamp, seen)
        self.outlet.acknowledge(FINISHED, stamp)

    def _settings(self, pose: Any) -> FusionSettings:
        """With the camera's direction as sure as its pose's covariance says, where that is given."""
        covariance = msg_to_covariance(pose)
        known = 0.0 if covariance is None else float(covariance.diagonal()[3:].max())
        angle = np.radians(self.config.angle_sigma_deg)
        return FusionSettings(
            float(np.sqrt(angle**2 + known)), self.config.dem_sigma, label_columns=self._label_columns
        )

    def _publish(self, fused: FusedDepth, stamp: int, seen: SceneView) -> None:
        frame = self._frame_id
        self.health.note(f"verdict.{fused.verdict.value}")
        if fused.verdict is not Verdict.OK:
            self.health.gauge("last_verdict", f"{fused.verdict.value}: {fused.reason}")
        self.health.gauge("verdict", fused.verdict.value)
        self.health.gauge("inlier_ratio", f"{fused.inlier_ratio:.3f}")
        info = {"camera": self.config.camera, "stamp_ns": stamp, **fused.info()}
        self.outlet.publish(FUSED_INFO, String(data=json.dumps(info)))
        metres = fused.network_depth() if self.outlet.wanted(NETWORK_DEPTH) else None
        if metres is not None:
            self.outlet.publish(NETWORK_DEPTH, depth_to_msg(metres, stamp, frame))
        measured = cache(partial(fused.measured, seen.doubtful))
        self.outlet.provide(MEASURED_SIGMA, stamp, lambda: depth_to_msg(measured().sigma, stamp, frame))
        self.outlet.provide(MEASURED_DEPTH, stamp, lambda: depth_to_msg(measured().depth, stamp, frame))
        self.outlet.provide(FUSED_SIGMA, stamp, lambda: depth_to_msg(fused.sigma, stamp, frame))
        self.outlet.provide(FUSED_SOURCE, stamp, lambda: image_to_msg(fused.source, "mono8", stamp, frame))
        self.outlet.provide(FUSED_DEPTH, stamp, lambda: depth_to_msg(fused.depth, stamp, frame))

    def _compile_kernels(self) -> None:
        """Now, or load them from numba's cache: the first frame shall not wait for it."""
        camera = Camera.from_fov(96, 64, 50.0)
        rows, cols = np.mgrid[0:64, 0:96]
        depth = (3000.0 / (4 + rows) + 0.1 * cols).astype(np.float32)
        depth[:10] = np.inf
        traced = DepthImage(depth, camera, Pose.from_angles((0.0, 0.0, 0.0), 0.0))
        rgb, labels = np.zeros((64, 96, 3), np.uint8), np.ones((64, 96), np.uint8)
        inverse = (1 / np.minimum(depth, 1e4)).astype(np.float32)
        for given in (labels, None):
            fuse(
                traced, NetworkDepth(inverse, "relative_inverse"), rgb, given, self._classes, config=self._config
            ).measured()


def _label_columns(model: str) -> int:
    """0 where the labels' network is not known here: another computer may run it."""
    try:
        return Manifest.find(model).label_columns
    except ModelError:
        return 0


NODE = NodeType("topodepth", TopoDepthConfig, TopoDepth)


def main() -> None:
    run_node(NODE)


if __name__ == "__main__":
    main()
