"""Publish the changed tiles of a region's map, and write the map as GeoTIFFs."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from nav_msgs.msg import OccupancyGrid
from rclpy.serialization import deserialize_message, serialize_message

from ltm_core.base.errors import ArchiveError, LtmError, MessageError, StoreError
from ltm_core.base.types import UInt8Array
from ltm_core.fuel.cell_state import TILE
from ltm_core.fuel.evidence import Window
from ltm_core.fuel.export.companion_files_io import item_path
from ltm_core.fuel.life_form import life_form_labels
from ltm_core.fuel.prior import system_of
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.storage.tile_store import Key
from ltm_core.uplink.config import AGGREGATOR, ExportConfig
from ltm_core.uplink.envelope import TileHeader, VotesGrid, header_of
from ltm_msgs_py.grid import msg_to_classes, tile_to_msg
from ltm_ros.fuel_map.export import export_site
from ltm_ros.fuel_map.source import FuelSource
from ltm_ros.region.aggregator import Aggregator
from ltm_ros.region.identity import Identity
from ltm_ros.region.mqtt_link import MqttLink, tile_topic
from ltm_ros.runtime.health import Health, cause_of


class TilePublisher:
    """Publishes tiles, which the broker retains, so that later followers get the whole map at once."""

    def __init__(self, region: str, aggregator: Aggregator, link: MqttLink) -> None:
        self._region, self._aggregator, self._link = region, aggregator, link
        self._due: set[Key] = set()
        self._sent: dict[Key, bytes] = {}
        """Published content of each tile."""
        self._store = aggregator.persistence.store
        self._classes = list(life_form_labels(aggregator.labels).names)
        site = aggregator.site
        self._grid = VotesGrid.of(site.in_crs(aggregator.geometry), site.origin)

    def note(self, windows: Sequence[Window]) -> None:
        """Record that parts of the map may have changed. Tiles without evidence, most of a region, are not
        published."""
        persistence = self._aggregator.persistence
        keys = {key for window in windows for key in persistence.map.tiles_of(window)}
        for row, col in keys:
            if (row, col) in self._sent or persistence.shown.tells((row * TILE, col * TILE, TILE, TILE)):
                self._due.add((row, col))

    def note_all(self) -> None:
        """Record that the broker may have lost everything: all tiles with evidence are due."""
        self._sent.clear()
        evidence = self._aggregator.persistence.map
        seen = evidence.layers().last_seen > 0
        rows, cols = evidence.tiles
        for row in range(rows):
            for col in range(cols):
                if seen[row * TILE : (row + 1) * TILE, col * TILE : (col + 1) * TILE].any():
                    self._due.add((row, col))

    def send(self) -> None:
        """Publish due tiles, as far as the connection accepts them."""
        persistence, geometry = self._aggregator.persistence, self._aggregator.geometry
        if (
            persistence.store is not self._store
        ):  # the store was unavailable until now, and the map had only what came since
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
    """Return a received tile: the header, class indices (h, w) with 255 unknown, and their place in the CRS. Raises
    MessageError unless the region's aggregator has signed it."""
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


class RegionExports:
    """Exports the current map, one export at a time, on a separate thread; failures are reported and tried again."""

    def __init__(self, config: ExportConfig, aggregator: Aggregator, health: Health) -> None:
        self._config, self._aggregator, self._health = config, aggregator, health
        self._empty = site_evidence_map(aggregator.site, aggregator.geometry, aggregator.labels).layers()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="export")
        self._work: Future[None] | None = None
        self._due, self._next_s = True, 0.0

    def look(self, now_s: float, changed: bool) -> None:
        """Start an export if the map has changed and the last one is old enough."""
        self._due |= changed
        if self._work is not None and not self._work.done():
            return
        self._judge()
        if self._due and now_s >= self._next_s:
            self._due, self._next_s = False, now_s + self._config.every
            self._work = self._pool.submit(self._write, self._source())

    def close(self, changed: bool = False) -> None:
        """Write the last state if it is not written yet; `changed`: since the last `look`."""
        self._due |= changed
        self._pool.shutdown()
        self._judge()
        if self._due:
            try:
                self._write(self._source())
            except Exception as error:
                self._tell(error)

    def _judge(self) -> None:
        """Check the result of the last export; after a failure, the map is due again."""
        work, self._work = self._work, None
        error = None if work is None else work.exception()
        if error is not None:
            self._due = True
            self._tell(error)

    def _tell(self, error: BaseException) -> None:
        if isinstance(error, LtmError):
            self._health.trouble(cause_of(error), f"the map was not exported: {error}")
        else:  # an internal error, or one of a library
            sys.excepthook(type(error), error, error.__traceback__)
            self._health.trouble("export", f"the map was not exported ({type(error).__name__}: {error}); see the log")

    def _source(self) -> FuelSource:
        """Return the current map, with copies of its layers."""
        aggregator = self._aggregator
        evidence = aggregator.persistence.map
        geometry = aggregator.site.in_crs(aggregator.geometry)
        layers = evidence.layers()
        return FuelSource(aggregator.site, aggregator.labels, geometry, evidence.prior, layers, self._empty)

    def _write(self, source: FuelSource) -> None:
        export_site(source, self._config.folder, None, "layers", system_of(source.prior).value, None, None)
        if self._config.copy_to:
            _copy(self._config.folder, self._config.copy_to)
        self._health.note("exported")


def _copy(folder: Path, url: str) -> None:
    """Copy the files of a folder to a store by fsspec; the STAC item last, so that everything that it names exists.
    Raises StoreError."""
    from ltm_ros.archive.results import ResultFolder  # needs the extra `archive`, only for copies

    files = sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    try:
        elsewhere = ResultFolder(url)
        for path in sorted(files, key=lambda path: path == item_path(folder)):
            elsewhere.put(path, path.name)
    except (ArchiveError, OSError) as error:
        raise StoreError(f"{url}: the export cannot be copied there ({error})") from error
