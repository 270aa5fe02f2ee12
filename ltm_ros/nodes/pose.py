"""pose: refine a mounted camera's pose from its images, and publish the correction for capture."""

from typing import Any

import numpy as np

from ltm_core.base.errors import ConfigError, StoreError
from ltm_core.geometry.camera import Camera
from ltm_core.pipeline.site_surface import mount_terms, site_terrain
from ltm_core.pose_estimation.mount.mount_io import memory_file, recall_memory, write_memory
from ltm_core.pose_estimation.mount.mount_watch import MountWatch
from ltm_core.pose_estimation.skyline.contour_scores import picture_evidence
from ltm_core.site.networks import site_scene_filter
from ltm_core.site.site_io import load_site
from ltm_core.vision.masks import Looking
from ltm_msgs_py.image import msg_to_array, msg_to_rgb
from ltm_msgs_py.pose import correction_to_msg, correction_values, msg_to_covariance, msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_msgs_py.stamp import stamp_of
from ltm_msgs_py.status import status_to_msg
from ltm_ros.runtime import topics
from ltm_ros.runtime.handler import NodeType, Outlet
from ltm_ros.runtime.health import Health, note_picture
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.stamp_join import JoinConfig, JoiningHandler, StampJoin


class PoseKeepingConfig(JoinConfig):
    folder: str = ""
    """Folder that keeps the mount's correction across restarts, relative to the site file. Empty: not kept."""


class PoseHandler(JoiningHandler[PoseKeepingConfig]):
    """Checks an image from time to time, at the cost of a few frames per minute."""

    publications = (topics.POSE_CORRECTION, topics.POSE_INFO)

    def __init__(self, config: PoseKeepingConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        site = load_site(config.site)
        self._scene = site_scene_filter(site, config.camera)
        if site.refine_poses is None:
            raise ConfigError(f"{config.site}: the node `pose` needs a section `refine_poses`")
        mount = site.camera(config.camera).mount
        tilt_zero_sigma = 0.0 if mount is None else mount.angle_sigmas_deg[3]
        self._watch = MountWatch(site_terrain(site), site.refine_poses, tilt_zero_sigma)
        self._assumed = site.assumed_pose_error.covariance()
        self._site, self._terms = site, ""
        folder = config.beside_site(config.folder)
        self._file = None if folder is None else memory_file(folder, config.camera)
        self._every_ns = round(site.refine_poses.every * 1e9)
        self._last_ns = -self._every_ns
        parts = {
            "image": topics.POSED_IMAGE,
            "info": topics.POSED_CAMERA_INFO,
            "pose": topics.STATED_POSE,
            "labels": topics.LABELS_IMAGE,
        }
        self._joins = [StampJoin(parts, self._look, health, max_wait=config.max_wait)]

    def start(self) -> None:
        camera = self._site.camera(self.config.camera)
        if camera.calibration is not None or (camera.mount is not None and camera.mount.lens is not None):
            self._recall(None)

    def _look(self, image: Any, info: Any, pose: Any, labels: Any) -> None:
        stamp = stamp_of(image)
        if 0 <= stamp - self._last_ns < self._every_ns:
            return
        photo = msg_to_rgb(image)
        camera, stated = msg_to_camera(info), msg_to_pose(pose, "map")
        seen = self._scene.look(photo, Looking.of(camera, stated), stamp)
        note_picture(self.health, seen)
        if seen.reason is not None:
            return  # the next one may be better
        self._last_ns = stamp
        if not self._terms:
            self._recall(camera)
        watch, before = self._watch, self._watch.correction
        evidence = picture_evidence(photo, msg_to_array(labels, ("mono8",)), camera, seen.hidden)
        covariance = msg_to_covariance(pose, self._assumed)
        assert covariance is not None  # nosec B101 # tells the type checker what holds
        clear = watch.look(evidence, stated, covariance)
        self.health.note("clear" if clear else "unclear")
        if not watch.correction.known:
            self.health.trouble(f"mount_{watch.state.value}", watch.reason)
        if watch.correction is not before:
            self.health.note(f"mount.{watch.state.value}")
            self._tell(stamp)
            if self._file is not None and self._terms:
                try:
                    write_memory(self._file, watch, self._terms)
                except StoreError as error:
                    self.health.trouble("mount_memory", str(error))
        self.health.gauge("mount", f"{watch.state.value}: {watch.reason}")

    def _tell(self, stamp: int) -> None:
        watch = self._watch
        rotation, angles = watch.correction.rotation, watch.correction.angles
        info = {
            "state": watch.state.value,
            "reason": watch.reason,
            "rotation_deg": np.degrees(rotation).round(4).tolist(),
            "sigma_deg": None if angles is None else np.degrees(np.sqrt(angles.diagonal())).round(4).tolist(),
            "slips": watch.slips,
        } | correction_values(watch.correction)
        name, wrong = f"{self.config.camera}/pose", not watch.correction.known
        self.outlet.publish(topics.POSE_INFO, status_to_msg(name, stamp, info, watch.reason, wrong))
        self.outlet.publish(topics.POSE_CORRECTION, correction_to_msg(watch.correction, stamp))

    def _recall(self, seen: Camera | None) -> None:
        """Load the stored correction. `seen`: calibration of the images, if the site has none."""
        if self._file is None or self._terms:
            return
        try:
            self._terms = mount_terms(self._site, self.config.camera, seen)
            if recall_memory(self._file, self._watch, self._terms):
                self.health.note("mount.recalled")
                self.health.gauge("mount", f"{self._watch.state.value}: {self._watch.reason}")
                self._tell(max(self.outlet.now_ns(), 0))
        except StoreError as error:
            self.health.trouble("mount_memory", str(error))


NODE = NodeType("pose", PoseKeepingConfig, PoseHandler)
run_node(NODE, __name__)
