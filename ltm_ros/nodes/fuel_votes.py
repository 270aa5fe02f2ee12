"""fuel_votes: turns a camera's depth and labels into votes for the few fuel cells that it sees."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ltm_core.depth.range_image import RangeImage
from ltm_core.fuel.votes import cast_votes
from ltm_core.resources import config_path
from ltm_core.site_io import load_site
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.camera_info import msg_to_camera
from ltm_msgs_py.image import msg_to_array, msg_to_depth
from ltm_msgs_py.pose import msg_to_pose
from ltm_msgs_py.stamp import stamp_of
from ltm_msgs_py.votes import votes_to_msg
from ltm_ros.handler import Handler, NodeConfig, NodeType, Outlet
from ltm_ros.health import Health
from ltm_ros.join import StampJoin
from ltm_ros.node import run_node
from ltm_ros.topics import DEPTH_CAMERA_INFO, DEPTH_IMAGE, FUEL_VOTES, LABELS_IMAGE, POSED_POSE


class FuelVotes(Handler[NodeConfig]):
    publications = (FUEL_VOTES,)

    def __init__(self, config: NodeConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        self._site = load_site(config.site)
        self._site.camera(config.camera)
        self._dem = self._site.open_dem()
        self._geometry = self._site.fuel_geometry(self._dem)
        self._labels = LabelSet.load(config_path(self._site.labels))
        self._votes_for = self._labels.votes_table[: len(self._labels)]
        self._join = StampJoin(("depth", "info", "labels", "pose"), self._vote, health)

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        return {
            DEPTH_IMAGE: lambda m: self._join.add("depth", stamp_of(m), m),
            DEPTH_CAMERA_INFO: lambda m: self._join.add("info", stamp_of(m), m),
            LABELS_IMAGE: lambda m: self._join.add("labels", stamp_of(m), m),
            POSED_POSE: lambda m: self._join.add("pose", stamp_of(m), m),
        }

    def finish(self) -> None:
        self._join.finish()

    def _vote(self, depth: Any, info: Any, labels: Any, pose: Any) -> None:
        ranges = RangeImage.from_depth(
            msg_to_depth(depth), msg_to_camera(info), msg_to_pose(pose, "map"), self._site.bend
        )
        votes = cast_votes(
            ranges,
            msg_to_array(labels, ("mono8",)),
            self._geometry,
            self._dem,
            self._votes_for,
            stamp_of(depth),
            self.config.camera,
            self._site.fuel.max_range,
        )
        self.outlet.publish(FUEL_VOTES, votes_to_msg(votes, self._labels.names))


NODE = NodeType("fuel_votes", NodeConfig, FuelVotes)


def main() -> None:
    run_node(NODE)


if __name__ == "__main__":
    main()
