"""Prints which kernels a region's map has compiled at its start and after its first frame and answer, and which
modules it has imported between: `FOLDER`, of a region's scene, with a frame of alta in `frame`."""

from __future__ import annotations

import json
import random
import sys
from pathlib import Path

from scenes.kernel_counts import compiled
from scenes.region_days import Broker, BrokerLink
from scenes.region_scene import REGION, RegionScene, stamp_of

from ltm_ros.region.mqtt_link import votes_topic
from ltm_ros.region.service import RegionService
from ltm_ros.runtime.health import Health


def main() -> None:
    scene, health, broker = RegionScene(Path(sys.argv[1])), Health(), Broker(random.Random(1))
    make_link = type("Link", (BrokerLink,), {"broker": broker})
    service = RegionService(scene.config, health, lambda: stamp_of(10), make_link)
    kernels, modules = compiled(), set(sys.modules)
    broker.publish(votes_topic(REGION, "alta"), (scene.folder / "frame").read_bytes(), retain=False)
    for _ in range(3):  # the broker delivers at once: two turns count, show and send
        service.step(0.01)
    assert service.aggregator.persistence.saved_frames == 1, health.last_error
    print(json.dumps([kernels, compiled(), sorted(set(sys.modules) - modules)]))


if __name__ == "__main__":
    main()
