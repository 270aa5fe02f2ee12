"""fuel_map: gathers the votes of all cameras of a site into its fuel map."""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from std_msgs.msg import String

from ltm_core.fuel.fuel_map_io import write_fuel_map
from ltm_core.fuel.majority import MajorityFuelMap
from ltm_core.resources import config_path
from ltm_core.site_io import load_site
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.grid import classes_to_msg, tile_to_msg
from ltm_msgs_py.stamp import stamp_of
from ltm_msgs_py.votes import msg_to_votes
from ltm_ros.handler import Handler, NodeConfig, NodeType, Outlet, Topic
from ltm_ros.health import Health
from ltm_ros.node import run_node
from ltm_ros.topics import FUEL_MAP, FUEL_MAP_INFO, FUEL_MAP_UPDATE, FUEL_VOTES, camera_topic

COUNTED = 100_000
"""Frames remembered, so that none is counted twice."""


class FuelMapConfig(NodeConfig):
    export_path: str = ""
    """GeoTIFF that the `save` service and a clean stop write; empty: none. Never taken from the wire."""


class FuelMap(Handler[FuelMapConfig]):
    """Sends the changed tile with every vote and the whole map, latched, at most twice a second."""

    publications = (FUEL_MAP, FUEL_MAP_UPDATE, FUEL_MAP_INFO)

    def __init__(self, config: FuelMapConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        self._site = load_site(config.site)
        self._labels = LabelSet.load(config_path(self._site.labels))
        self._map = MajorityFuelMap(self._site.fuel_geometry(self._site.open_dem()), len(self._labels))
        self._counted: OrderedDict[tuple[str, int], None] = OrderedDict()
        self._newest = 0
        self._dirty = False

    @property
    def subscriptions(self) -> Mapping[Topic, Callable[[Any], None]]:
        return {
            Topic(camera_topic(self._site.name, camera, FUEL_VOTES), FUEL_VOTES.type): partial(self.on_votes, camera)
            for camera in self._site.cameras
        }

    @property
    def services(self) -> Mapping[str, Callable[[], str]]:
        return {"fuel_map/save": self.save}

    def start(self) -> None:
        geometry = self._site.in_crs(self._map.geometry)
        info = self._labels.info() | {"crs": geometry.crs, "x_min": geometry.x_min, "y_max": geometry.y_max}
        self.outlet.publish(FUEL_MAP_INFO, String(data=json.dumps(info)))
        self._publish_map()

    def on_votes(self, camera: str, message: Any) -> None:
        stamp = stamp_of(message)
        if (camera, stamp) in self._counted:
            self.health.drop("duplicate", f"votes of {camera} of stamp {stamp} ns came twice; counted once")
            return
        window = self._map.add(msg_to_votes(message, self._map.geometry, self._labels.names, camera))
        self._counted[camera, stamp] = None
        if len(self._counted) > COUNTED:
            self._counted.popitem(last=False)
        self._newest = max(self._newest, stamp)
        self.health.gauge("frames", len(self._counted))
        if window is None:
            self.health.note("empty_votes")
            return
        self._dirty = True
        tile = tile_to_msg(self._map.classes(), self._map.geometry, window, stamp)
        self.outlet.publish(FUEL_MAP_UPDATE, tile)

    def tick(self, waited: float) -> None:
        if self._dirty:
            self._publish_map()

    def finish(self) -> None:
        self._publish_map()
        if self.config.export_path:
            self.save()

    def save(self) -> str:
        """Write the map to the configured file. Raises ConfigError where none is configured."""
        path = write_fuel_map(
            self.config.export_path, self._map.classes(), self._site.in_crs(self._map.geometry), self._labels
        )
        return f"fuel map of {len(self._counted)} frames written to {Path(path).name}"

    def _publish_map(self) -> None:
        self._dirty = False
        self.outlet.publish(FUEL_MAP, classes_to_msg(self._map.classes(), self._map.geometry, self._newest))


NODE = NodeType("fuel_map", FuelMapConfig, FuelMap)


def main() -> None:
    run_node(NODE)


if __name__ == "__main__":
    main()
