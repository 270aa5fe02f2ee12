"""The fuel map's node without its transport: a handler that a test feeds with numbered frames."""

from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.fuel.evidence import EVIDENCE_FIELDS, EvidenceMap
from ltm_ros.fuel_map.services import FuelMapConfig
from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.runtime.health import Health
from scenes.fuel_frames import camera_of, message
from scenes.outlets import Kept


class Node:
    """A handler, its outlet and its health."""

    def __init__(self, site: Path, now: int = 0, **config: Any) -> None:
        self.outlet, self.health = Kept(), Health()
        self.outlet.now = now
        self.handler = FuelMapHandler(FuelMapConfig(site=str(site), **config), self.outlet, self.health)
        self.handler.start()

    def feed(self, *numbers: int, idle: bool = True) -> None:
        for number in numbers:
            self.handler.on_votes(camera_of(number), message(number, self.map.geometry))
        if idle:
            self.handler.idle()

    @property
    def map(self) -> EvidenceMap:
        return self.handler.persistence.map

    def gauge(self, name: str) -> str:
        return self.health.summary()[name]


def state(evidence: EvidenceMap) -> dict[str, np.ndarray]:
    tiles = [evidence.tile_state(key) for key in evidence.tiles_of((0, 0, *evidence.geometry.shape))]
    return {name: np.stack([tile[name] for tile in tiles]) for name in EVIDENCE_FIELDS}


def assert_same_state(found: EvidenceMap, expected: EvidenceMap) -> None:
    for name, values in state(expected).items():
        np.testing.assert_array_equal(state(found)[name], values, err_msg=name)
