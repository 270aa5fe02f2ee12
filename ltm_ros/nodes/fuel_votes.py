"""fuel_votes: convert a camera's depth and labels into votes for the fuel cells that it sees, with their geometry."""

from typing import Any

from ltm_core.pipeline.frame_steps import VotingStep
from ltm_core.pipeline.kernels import compile_kernels
from ltm_core.pipeline.pose_watch import PoseWatch
from ltm_core.site.site_io import load_site
from ltm_core.vision.segmenter import Segmentation
from ltm_msgs_py.image import msg_to_array, msg_to_depth
from ltm_msgs_py.pointcloud import votes_to_msg
from ltm_msgs_py.pose import msg_to_covariance, msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime import topics
from ltm_ros.runtime.handler import NodeType, Outlet
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.stamp_join import JoinConfig, JoiningHandler, StampJoin


class FuelVotesHandler(JoiningHandler[JoinConfig]):
    publications = (topics.FUEL_VOTES,)

    def __init__(self, config: JoinConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        self._site = site = load_site(config.site)
        self._step, self._watch = VotingStep(site, config.camera), PoseWatch(site)
        self._too_steep = 0
        parts = {
            "depth": topics.DEPTH_IMAGE,
            "info": topics.DEPTH_CAMERA_INFO,
            "labels": topics.LABELS_IMAGE,
            "confidence": topics.LABELS_CONFIDENCE,
            "pose": topics.POSED_POSE,
        }
        self._joins = [StampJoin(parts, self._vote, health, max_wait=config.max_wait)]

    def start(self) -> None:
        """Compile the kernels, so that the first frame is not delayed."""
        compile_kernels("fuel_votes", self._site)

    def _vote(self, depth: Any, info: Any, labels: Any, confidence: Any, pose: Any) -> None:
        stamp, camera, posed = stamp_of(depth), msg_to_camera(info), msg_to_pose(pose, "map")
        found = Segmentation(msg_to_array(labels, ("mono8",)), msg_to_array(confidence, ("mono8",)))
        covariance = msg_to_covariance(pose, self._step.assumed)
        votes = self._step.cast(msg_to_depth(depth), camera, posed, found, stamp, covariance)
        self._watch.look(found.labels, camera, posed, covariance, stamp)
        self.health.doubt("pose_contradicted", self._watch.reason)
        sent = self._step.carried(votes)
        if len(sent) < len(votes):
            self.health.note("votes_in_turns")
        self._too_steep += votes.too_steep
        if self._too_steep:
            self.health.gauge("withdrawn.too_steep", self._too_steep)
        self.outlet.publish(topics.FUEL_VOTES, votes_to_msg(sent, self._step.labels.names))


NODE = NodeType("fuel_votes", JoinConfig, FuelVotesHandler)
run_node(NODE, __name__)
