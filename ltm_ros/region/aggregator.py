"""Keep the fuel map of a region: receive signed votes of many towers, count each frame once, acknowledge stored
frames, and export the map.

The map, its store and the rules for votes are those of a site's node `fuel_map`."""

import sys
from collections import defaultdict
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2

from ltm_core.base.errors import LtmError, MessageError
from ltm_core.base.redaction import plain
from ltm_core.base.resources import config_path
from ltm_core.fuel.prior import system_of
from ltm_core.fuel.vote_columns import MAX_BYTES
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.pipeline.stored_fuel import STORE_FILE, fuel_schema
from ltm_core.site.site_io import load_site
from ltm_core.storage.tile_store import TileStore
from ltm_core.uplink.config import AGGREGATOR, ExportConfig, RegionConfig
from ltm_core.uplink.envelope import (
    LONGEST_REASON,
    MOST_OUTCOMES,
    VERSION,
    AckHeader,
    Envelope,
    HeaderStart,
    Outcome,
    Outcomes,
    VotesGrid,
    VotesHeader,
    header_of,
)
from ltm_core.uplink.vote_transfer import VoteTransfer
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.pointcloud import msg_to_votes
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.fuel_map.export import export_site
from ltm_ros.fuel_map.persistence import CountedFrame, Counting, FuelMapPersistence
from ltm_ros.fuel_map.source import FuelSource
from ltm_ros.region.identity import Identity
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.stamp_check import StampCheck

FrameId = tuple[str, str, int]
"""(tower, camera, stamp in nanoseconds)."""


class Aggregator:
    """Uses no transport: `take` receives a tower's message, `settle` returns the answers. `now_ns`: the time."""

    def __init__(self, config: RegionConfig, health: Health, now_ns: Callable[[], int]) -> None:
        """Open the region's map. Raises LtmError for an invalid site, store or certificate."""
        self.site = load_site(config.site)
        self.identity = Identity(config.broker, AGGREGATOR)
        self._config, self._health = config, health
        self.labels = LabelSet.load(config_path(self.site.labels))
        self.geometry = self.site.fuel_geometry(self.site.open_dem())
        """The fuel grid in the map frame."""
        schema = fuel_schema(self.site, self.geometry)
        self.persistence = FuelMapPersistence(
            lambda: site_evidence_map(self.site, self.geometry, self.labels),
            lambda: TileStore.open(config.folder / STORE_FILE, schema),
            health,
        )
        self._stamps = StampCheck(now_ns, health, config.max_ahead, config.max_behind)
        self._transfers: dict[str, tuple[VotesGrid, VoteTransfer]] = {}
        self._cameras: dict[str, tuple[str, str]] = {}
        """Tower and camera by the name that the map knows them by."""
        self._outcomes: dict[str, list[Outcome]] = defaultdict(list)

    def take(self, tower: str, content: bytes) -> None:
        """Take a message of a tower. Invalid ones are counted by cause and, if they name their frame, answered with the
        reason."""
        try:
            if tower not in self._config.towers:
                raise MessageError(f"{tower!r} is not a tower of {self._config.name}: add it to towers in region.yaml")
            self._health.received(f"/{self._config.name}/{tower}/votes")
            envelope = self.identity.opened(content, tower)
            start = header_of(HeaderStart, envelope)
            if (start.region, start.tower) != (self._config.name, tower):
                raise MessageError(
                    f"votes on the topic of {tower} in {self._config.name} are from {start.tower} in {start.region}"
                )
        except LtmError as error:
            # The sender is unknown, so there is nothing to acknowledge.
            self._health.drop(cause_of(error), plain(str(error)))
            return
        frame = tower, start.camera, start.stamp_ns
        try:
            refusal = self._count(frame, start, envelope)
        except LtmError as error:
            refusal = plain(str(error))
            self._health.drop(cause_of(error), f"{tower}/{start.camera}: {refusal}")
        if refusal:
            self._answer(frame, refusal)

    def settle(self) -> dict[str, list[bytes]]:
        """Store the counted frames; return sealed acknowledgements by tower."""
        answers = self._sealed(self.persistence.settle(show=False))
        self._health.gauge("frames", self.persistence.saved_frames)
        self._health.gauge("unsaved_frames", self.persistence.unsaved_frames)
        return answers

    def close(self) -> dict[str, list[bytes]]:
        """Store all frames if possible; return acknowledgements by tower. A tower sends an unstored frame again."""
        return self._sealed(self.persistence.close())

    def _count(self, frame: FrameId, start: HeaderStart, envelope: Envelope) -> str:
        """Count a frame; return why it was not counted, or nothing. Raises LtmError for invalid votes."""
        tower, camera, stamp = frame
        if start.version != VERSION:
            raise MessageError(
                f"votes of version {start.version}, but {self._config.name} reads {VERSION}: update the older side"
            )
        source = f"{tower}_{camera}"
        if source not in self.site.cameras:
            raise MessageError(
                f"{source} is not a camera of {self.site.name}: add it to cameras in {self._config.site.name}"
            )
        header = header_of(VotesHeader, envelope)
        counting = self.persistence.seen(source, stamp)
        if counting is None:
            if self._stamps.refuses(f"votes of {source}", stamp):
                return self._health.last_error
            transfer = self._transfer(tower, header.grid)
            message = _message(envelope.body)
            if stamp_of(message) != stamp:
                raise MessageError(f"the header states stamp {stamp} ns, the votes {stamp_of(message)} ns")
            votes = msg_to_votes(message, header.grid.in_map, self.labels.names, source)
            counting = self.persistence.count(transfer.votes(votes), header.model)
        if counting is Counting.COUNTED:
            self._cameras[source] = tower, camera
        elif counting is Counting.DUPLICATE:
            self._health.note("duplicate")
            if self.persistence.stored(source, stamp):
                self._answer(frame)
        elif counting is Counting.TOO_OLD:
            self._health.drop("too_old", f"votes of {source} of stamp {stamp} ns are older than the remembered stamps")
            self._answer(frame)
        else:
            self._health.note("empty_votes")
            self._answer(frame)
        return ""

    def _transfer(self, tower: str, grid: VotesGrid) -> VoteTransfer:
        """Return the transfer from the grid of a tower; one per tower is kept."""
        found = self._transfers.get(tower)
        if found is None or found[0] != grid:
            shared = next((known for known in self._transfers.values() if known[0] == grid), None)
            found = shared or (grid, VoteTransfer(grid.geometry, self.site.in_crs(self.geometry), self.geometry))
            self._transfers[tower] = found
        return found[1]

    def _answer(self, frame: FrameId, refusal: str = "") -> None:
        tower, camera, stamp = frame
        self._outcomes[tower].append(
            Outcome(camera=camera, stamp_ns=stamp, done=not refusal, why=refusal[:LONGEST_REASON])
        )

    def _sealed(self, stored: Iterable[CountedFrame]) -> dict[str, list[bytes]]:
        """Return the sealed answers for these frames, and for others that were decided before."""
        for counted in stored:
            self._answer((*self._cameras[counted.record.source], counted.record.stamp_ns))
        answers: dict[str, list[bytes]] = {}
        for tower, outcomes in self._outcomes.items():
            header = AckHeader(region=self._config.name, tower=tower).model_dump_json().encode()
            parts = [outcomes[first : first + MOST_OUTCOMES] for first in range(0, len(outcomes), MOST_OUTCOMES)]
            bodies = [Outcomes(outcomes=part).model_dump_json().encode() for part in parts]
            answers[tower] = [self.identity.sealed(header, body) for body in bodies]
        self._outcomes.clear()
        return answers


def _message(content: bytes) -> PointCloud2:
    if len(content) > MAX_BYTES:
        raise MessageError(f"votes of {len(content)} bytes; the maximum is {MAX_BYTES}")
    try:
        return deserialize_message(content, PointCloud2)
    except Exception as error:  # RMWError is the binding's own; std::bad_alloc comes as MemoryError
        raise MessageError(f"{len(content)} bytes do not decode as votes ({str(error).splitlines()[0]})") from error


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
        if changed:
            self._due = True
        if (self._work is None or self._work.done()) and self._due and now_s >= self._next_s:
            self._due, self._next_s = False, now_s + self._config.every
            self._work = self._pool.submit(self._write, self._source())

    def close(self, changed: bool = False) -> None:
        """Write the last state if it is not written yet; `changed`: since the last `look`."""
        self._due |= changed
        self._pool.shutdown()
        if self._due:
            self._write(self._source())

    def _source(self) -> FuelSource:
        """Return the current map, with copies of its layers."""
        aggregator = self._aggregator
        evidence = aggregator.persistence.map
        geometry = aggregator.site.in_crs(aggregator.geometry)
        layers = evidence.layers()
        return FuelSource(aggregator.site, aggregator.labels, geometry, evidence.prior, layers, self._empty)

    def _write(self, source: FuelSource) -> None:
        """Write the export; if it fails, report why, and the map is due again."""
        kind = system_of(source.prior).value
        try:
            export_site(source, self._config.folder, None, "layers", kind, None, None)
            self._health.note("exported")
        except Exception as error:
            self._due = True
            if isinstance(error, LtmError):
                cause, why = cause_of(error), str(error)
            else:  # an internal error, or one of a library
                sys.excepthook(type(error), error, error.__traceback__)
                cause, why = "export", f"{type(error).__name__}: {error}; see the log"
            self._health.trouble(cause, f"the map was not exported ({why})")
