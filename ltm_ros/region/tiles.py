"""Sends the tiles of a region's map that have changed, and reads them on the other side."""

from __future__ import annotations

from collections.abc import Sequence

from nav_msgs.msg import OccupancyGrid
from rclpy.serialization import deserialize_message, serialize_message

from ltm_core.base.errors import MessageError
from ltm_core.base.types import UInt8Array
from ltm_core.fuel.cell_state import TILE
from ltm_core.fuel.evidence import Window
from ltm_core.fuel.life_form import life_form_labels
from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.tile_store import Key
from ltm_core.uplink.config import AGGREGATOR
from ltm_core.uplink.envelope import TileHeader, VotesGrid, header_of
from ltm_msgs_py.grid import msg_to_classes, tile_to_msg
from ltm_ros.region.aggregator import Aggregator
from ltm_ros.region.identity import Identity
from ltm_ros.region.mqtt_link import MqttLink, tile_topic


class TilePublisher:
    """Each tile is retained by the broker, so that who comes later has the whole map at once."""

    def __init__(self, region: str, aggregator: Aggregator, link: MqttLink) -> None:
        self._region, self._aggregator, self._link = region, aggregator, link
        self._due: set[Key] = set()
        self._sent: dict[Key, bytes] = {}
        """What followers have of each tile."""
        self._store = aggregator.persistence.store
        self._classes = list(life_form_labels(aggregator.labels).names)
        site = aggregator.site
        self._grid = VotesGrid.of(site.in_crs(aggregator.geometry), site.origin)

    def note(self, windows: Sequence[Window]) -> None:
        """These parts of the map may have changed. Where nobody has looked yet, nothing is sent: most of a region."""
        persistence = self._aggregator.persistence
        keys = {key for window in windows for key in persistence.map.tiles_of(window)}
        for row, col in keys:
            if (row, col) in self._sent or persistence.shown.tells((row * TILE, col * TILE, TILE, TILE)):
                self._due.add((row, col))

    def note_all(self) -> None:
        """The broker may have forgotten what it was sent: all tiles with evidence are due."""
        self._sent.clear()
        evidence = self._aggregator.persistence.map
        seen = evidence.layers().last_seen > 0
        rows, cols = evidence.tiles
        for row in range(rows):
            for col in range(cols):
                if seen[row * TILE : (row + 1) * TILE, col * TILE : (col + 1) * TILE].any():
                    self._due.add((row, col))

    def send(self) -> None:
        """Send what is due, as far as the connection takes it."""
        persistence, geometry = self._aggregator.persistence, self._aggregator.geometry
        if persistence.store is not self._store:  # it was away so far, and the map held but what came since
            self._store = persistence.store
            self.note_all()
        while self._due:
            row, col = key = min(self._due)
            height, width = min(TILE, geometry.height - row * TILE), min(TILE, geometry.width - col * TILE)
            shown = persistence.shown.life_form[row * TILE : row * TILE + height, col * TILE : col * TILE + width]
            if self._sent.get(key) == (content := shown.tobytes()):
                self._due.discard(key)
                continue
            stamp = persistence.map.newest_ns
            message = tile_to_msg(persistence.shown.life_form, geometry, (row * TILE, col * TILE, height, width), stamp)
            header = TileHeader(
                region=self._region, row=row, col=col, stamp_ns=stamp, grid=self._grid, classes=self._classes
            )
            sealed = self._aggregator.identity.sealed(header.model_dump_json().encode(), serialize_message(message))
            if not self._link.send(tile_topic(self._region, row, col), sealed, retain=True, qos=1):
                return
            self._sent[key] = content
            self._due.discard(key)


def opened_tile(identity: Identity, content: bytes) -> tuple[TileHeader, UInt8Array, GridGeometry]:
    """What a subscriber was sent: the header, class indices (h, w) with 255 unknown, and where they are, in the CRS.

    Raises MessageError for anything that the region's aggregator has not signed.
    """
    envelope = identity.opened(content, AGGREGATOR)
    header = header_of(TileHeader, envelope)
    try:
        message = deserialize_message(envelope.body, OccupancyGrid)
    except Exception as error:  # RMWError is the binding's own
        raise MessageError(
            f"{len(envelope.body)} bytes do not decode as a tile ({str(error).splitlines()[0]})"
        ) from error
    classes, geometry = msg_to_classes(message)
    return header, classes, geometry.translated(*header.grid.origin, crs=header.grid.crs)
