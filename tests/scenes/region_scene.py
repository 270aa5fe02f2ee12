"""A region of two towers without a broker: certificates, a site of the region, one of a tower, and sealed frames."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rclpy.serialization import serialize_message

from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.geometry.grid import GridGeometry
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.uplink.config import AGGREGATOR, BrokerConfig, RegionConfig, load_region
from ltm_core.uplink.envelope import VotesGrid, VotesHeader
from ltm_ros.region.certs import TrialAuthority
from ltm_ros.region.identity import Identity
from scenes.fuel_frames import BEGIN_NS, message, write_site

REGION = "kern"
TOWERS = ("alta", "bear")
CAMERA = "mast"


@dataclass(frozen=True)
class RegionScene:
    """`alta` and `bear` count on the grid of the region's own site."""

    folder: Path
    port: int = 8883

    @cached_property
    def certs(self) -> Path:
        return self.folder / "certs"

    @cached_property
    def config(self) -> RegionConfig:
        return load_region(self.folder / "region.yaml")

    @cached_property
    def site(self) -> Site:
        return load_site(self.config.site)

    @cached_property
    def geometry(self) -> GridGeometry:
        """The fuel grid in the map frame."""
        return self.site.fuel_geometry(self.site.open_dem())

    @cached_property
    def grid(self) -> VotesGrid:
        return VotesGrid.of(self.site.in_crs(self.geometry), self.site.origin)

    def broker(self, name: str) -> BrokerConfig:
        files = {"certificate": self.certs / f"{name}.crt", "key": self.certs / f"{name}.key"}
        return BrokerConfig(host="127.0.0.1", port=self.port, ca=self.certs / "ca.crt", **files)

    def identity(self, name: str) -> Identity:
        return Identity(self.broker(name), name)

    def header(self, tower: str, number: int, **changes: Any) -> VotesHeader:
        given: dict[str, Any] = {
            "region": REGION,
            "tower": tower,
            "camera": CAMERA,
            "stamp_ns": stamp_of(number),
            "model": "landscape_lite0",
            "grid": self.grid,
        }
        return VotesHeader(**given | changes)

    def votes(self, number: int) -> bytes:
        """A frame's message, of the region's grid."""
        return bytes(serialize_message(message(number, self.geometry, stamp_of(number))))

    def sealed(self, tower: str, number: int, **changes: Any) -> bytes:
        """What a tower sends of a frame; `changes`: of the header."""
        header = self.header(tower, number, **changes).model_dump_json().encode()
        return self.identity(tower).sealed(header, self.votes(number))


def stamp_of(number: int) -> int:
    return BEGIN_NS + number * 10**9


def write_region_scene(folder: Path, port: int = 8883, **changes: Any) -> RegionScene:
    """`port`: of the broker. `changes`: of region.yaml."""
    write_site(folder, name="kern_map", cameras={f"{tower}_{CAMERA}": {} for tower in TOWERS})
    TrialAuthority(folder / "certs", days=2).make(REGION, [*TOWERS, "desk"], ["127.0.0.1"], "127.0.0.1", port)
    files = {"ca": "certs/ca.crt", "certificate": f"certs/{AGGREGATOR}.crt", "key": f"certs/{AGGREGATOR}.key"}
    region = {
        "name": REGION,
        "site": "site.yaml",
        "folder": "map",
        "towers": list(TOWERS),
        "broker": {"host": "127.0.0.1", "port": port, **files},
        "max_behind": 1e9,
    }
    (folder / "region.yaml").write_text(yaml.safe_dump(region | changes), encoding="utf-8")
    (folder / "map").mkdir(exist_ok=True)
    return RegionScene(folder, port)


def same_map(one: EvidenceMap, other: EvidenceMap) -> bool:
    """Return whether all cells of two maps, and the time of their newest frames, are the same to the bit."""
    for key in one.tiles_of((0, 0, *one.geometry.shape)):
        mine, theirs = one.tile_state(key), other.tile_state(key)
        if any(not np.array_equal(mine[name], theirs[name]) for name in mine):
            return False
    return one.newest_ns == other.newest_ns
