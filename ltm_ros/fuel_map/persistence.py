"""Keep a fuel map and its store consistent: frames count in memory at once, and are acknowledged once they are on
disk."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from enum import Enum
from typing import NamedTuple

from ltm_core.base.errors import LtmError, StoreError
from ltm_core.fuel.evidence import EvidenceMap, Window
from ltm_core.fuel.votes import CellVotes
from ltm_core.pipeline.stored_fuel import restore, votes_of, votes_to_bytes
from ltm_core.storage.tile_store import Key, TileStore
from ltm_core.storage.tile_store_schema import CellChanges, FrameRecord, Tile
from ltm_ros.fuel_map.layers import ShownLayers
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.retry import LAST_PAUSE_S, LAST_TRIES_S, Backoff

LOGGED_FRAMES = 1000
"""Maximum number of frames in the store before its tiles are written; opening it counts them again."""
LOGGED_BYTES = 64 << 20
UNSAVED_FRAMES = 500_000
"""Maximum number of frames counted only in memory, while the disk fails, before more are rejected: three hours of 40
per second."""
UNSAVED_BYTES = 256 << 20
"""The same in bytes, if the store has not been opened yet, so that the frames must be counted again."""
SLOW_S = 1.0
"""Seconds for one transaction above which a warning is given: the disk may be failing, or overloaded."""
AGE_NS = 3600 * 10**9
"""Map time in ns after which cells without new frames are recomputed."""


class Counting(Enum):
    """Whether a frame was counted, and if not, why."""

    COUNTED = "counted"
    EMPTY = "empty"
    """It has votes for no cell, so nothing is stored, and such frames displace no others."""
    DUPLICATE = "duplicate"
    TOO_OLD = "too_old"


class CountedFrame(NamedTuple):
    """A counted frame; `window`: cells that it may have changed, None for none."""

    record: FrameRecord
    window: Window | None


class FuelMapPersistence:
    """Counts frames into a map and keeps it in a store.

    `settle` writes what was counted since the last call, in one transaction, and returns the frames to acknowledge.
    While the disk fails, the map continues in memory and nothing is acknowledged; afterwards everything is written.

    `make_map`: returns the site's map without evidence. `open_store`: returns the store; after a StoreError it is tried
    again, and a ConfigError ends it. `durable`: whether the store outlives the process."""

    def __init__(
        self,
        make_map: Callable[[], EvidenceMap],
        open_store: Callable[[], TileStore],
        health: Health,
        durable: bool = True,
    ) -> None:
        self._make_map, self._open_store, self._health, self._durable = make_map, open_store, health, durable
        self.map = make_map()
        self.shown = ShownLayers(self.map)
        self.store: TileStore | None = None
        self.saved_frames = 0
        """Frames acknowledged since the store was created."""
        self._initial = self.shown.copies()
        self._batch: list[CountedFrame] = []
        self._in_batch: set[tuple[str, int]] = set()
        self._batch_bytes = 0
        self._unshown: list[Window] = []
        self._aged_ns = 0
        self._changes: list[CellChanges] = []
        self._dirty: set[Key] = set()
        self._keys: dict[Key, Key] = {}
        """Shared names of tiles, so that a long outage does not fill the memory."""
        self._logged = self._logged_bytes = 0
        self.failure = ""
        """The store's last error, in words."""
        self._failed = False
        self._pace = Backoff()
        self._open()

    @property
    def unsaved_frames(self) -> int:
        """Return the number of frames counted only in memory."""
        return len(self._batch)

    def seen(self, source: str, stamp_ns: int) -> Counting | None:
        """Return why a frame must not be counted; None if it may be."""
        if (source, stamp_ns) in self._in_batch:
            return Counting.DUPLICATE
        if self.store is not None and self.store.counted(source, stamp_ns):
            return Counting.TOO_OLD if self.store.forgotten(source, stamp_ns) else Counting.DUPLICATE
        return None

    def stored(self, source: str, stamp_ns: int) -> bool:
        """Return whether an already counted frame is on disk, so that it may be acknowledged again."""
        counted = self.store is not None and self.store.counted(source, stamp_ns)
        return counted and (source, stamp_ns) not in self._in_batch

    def count(self, votes: CellVotes, model: str = "") -> Counting:
        """Count a frame, once. Raises LtmError if it is rejected; then nothing of it is counted."""
        if (before := self.seen(votes.source, votes.stamp_ns)) is not None:
            return before
        if len(self._batch) >= UNSAVED_FRAMES or self._batch_bytes > UNSAVED_BYTES:
            raise StoreError(
                f"the store has not been writable for {len(self._batch)} frames; no more are accepted until it is"
            )
        payload = votes_to_bytes(votes) if self._durable and not self._failed else b""
        window = self.map.add(votes)
        if window is None:
            return Counting.EMPTY
        tiles = [self._keys.setdefault(key, key) for key in self.map.tiles_of(window)]
        record = FrameRecord(votes.source, votes.stamp_ns, tiles, model, payload)
        self._take(CountedFrame(record, self.map.reached_from(window)))
        return Counting.COUNTED

    def replace_tiles(
        self,
        tiles: Mapping[Key, Tile],
        source: str = "",
        stamp_ns: int = 0,
        window: Window | None = None,
        changes: Sequence[CellChanges] = (),
    ) -> None:
        """Replace the state of tiles, such as when a region is cleared; the next `settle` writes it. `source`,
        `stamp_ns`: origin of the change. `window`: the changed cells. `changes`: further entries of the journal."""
        for key, tile in tiles.items():
            self.map.load_tile(key, tile)
        self._dirty.update(tiles)
        self._changes += [*changes, *self.shown.refresh_all()]
        self._logged = LOGGED_FRAMES + 1  # no payload could restore this state
        if not source:
            return
        while (before := self.seen(source, stamp_ns)) is Counting.DUPLICATE:
            stamp_ns += 1
        if before is None:
            record = FrameRecord(source, stamp_ns, sorted(tiles))
            self._take(CountedFrame(record, window and self.map.reached_from(window)))

    def restart(self, frames: Sequence[CellVotes]) -> None:
        """Start again from the map that `make_map` returns now, and count these frames into it. Of the evidence until
        now, only burns and changes of the surface remain; all frames stay known as counted."""
        before, self.map = self.map, self._make_map()
        self.map.recall(before.surface_changes)
        for key in before.tiles_of((0, 0, *before.geometry.shape)):
            tile = before.tile_state(key)
            if tile["last_seen"].any() or tile["burned_at"].any():
                self._dirty.add(key)
                self.map.load_tile(key, self.map.tile_state(key) | {"burned_at": tile["burned_at"]})
        for votes in frames:
            if (window := self.map.add(votes)) is not None:
                self._dirty.update(self.map.tiles_of(window))
        self._unshown = []
        self._changes += self.shown.refresh_all(self.map)
        self._logged = LOGGED_FRAMES + 1  # no payload could restore this state

    def wait(self, seconds: float) -> None:
        """Advance time: retry a failed store periodically."""
        self._pace.passed(seconds)
        if self.store is None and self._pace.due:
            self._open()

    def show(self) -> list[Window]:
        """Recompute `shown` where frames were counted; return those parts of the map."""
        windows, self._unshown = self._unshown, []
        if self.map.newest_ns - self._aged_ns >= AGE_NS:
            # Evidence also decays, and burns end, where no camera sees them.
            self._aged_ns = self.map.newest_ns
            windows = [(0, 0, *self.map.geometry.shape)]
        self._changes += self.shown.refresh(windows)
        return windows

    def settle(self, write_tiles: bool = False, last: bool = False, show: bool = True) -> list[CountedFrame]:
        """Recompute `shown` (unless the caller calls `show` itself) and write what was counted; return the frames to
        acknowledge. `write_tiles`: write the whole map, at once even after an outage. `last`: nothing follows."""
        if show:
            self.show()
        if self.store is None or (self._failed and not self._pace.due and not write_tiles):
            return []
        frames, size = self._logged + len(self._batch), self._logged_bytes + self._batch_bytes
        full = frames > LOGGED_FRAMES or size > LOGGED_BYTES
        tiles = self._dirty if self._durable and (write_tiles or full or self._failed) else set()
        if not (self._batch or tiles or self._changes):
            return []
        begun = time.monotonic()
        try:
            self.store.commit(
                {key: self.map.tile_state(key) for key in sorted(tiles)},
                [counted.record for counted in self._batch],
                self._changes if self._durable else (),
                last,
            )
        except LtmError as error:
            # The next attempt writes tiles, so payloads need not be kept.
            self._failed, self._batch_bytes = True, 0
            self._batch = [CountedFrame(replace(c.record, payload=b""), c.window) for c in self._batch]
            self._trouble(error, f"{len(self._batch)} frames are in memory only")
            return []
        if (took := time.monotonic() - begun) > SLOW_S:
            self._health.trouble(
                "store_slow",
                f"the disk took {took:.1f} s to store {len(self._batch)} frames: check its health (smartctl), and "
                "what else writes to it",
            )
        self._changes, self._logged, self._logged_bytes = [], frames, size
        if tiles:
            self._dirty.clear()
            self._logged = self._logged_bytes = 0
        saved = self._taken()
        self.saved_frames += len(saved)
        if self._failed:
            self._failed = False
            self._pace.succeeded()
            self._health.note("store_back")
        if self.store.strain:
            self._health.trouble("store", self.store.strain)
        return saved

    def close(self) -> list[CountedFrame]:
        """Write everything, trying for `LAST_TRIES_S`, and close the store; return the frames to acknowledge.
        `unsaved_frames` are lost, but were not acknowledged."""
        self._changes += self.shown.refresh_all()
        until = time.monotonic() + LAST_TRIES_S
        saved = self.settle(write_tiles=True, last=True)
        while self._batch and time.monotonic() < until:
            time.sleep(LAST_PAUSE_S)
            if self.store is None:
                self._open()
            saved += self.settle(write_tiles=True, last=True)
        if self.store is not None:
            self.store.close()
        return saved

    def _open(self) -> None:
        """Load the store; frames that were counted without it are counted into its map."""
        store = None
        try:
            store = self._open_store()
            evidence = self._make_map()  # the last attempt may have filled one in part
            newer = restore(store, evidence)
        except StoreError as error:
            if store is not None:
                store.close()
            self._trouble(error, f"the map starts empty, {len(self._batch)} frames are in memory only")
            return
        self._pace.succeeded()
        before = self._taken()
        self._unshown = []
        self.store, self.map, self._dirty = store, evidence, newer
        self._logged = LOGGED_FRAMES if newer else 0  # written with the next frames
        self.saved_frames = store.frame_count()
        self.shown = ShownLayers(self.map)
        self._aged_ns = self.map.newest_ns
        self._changes = self.shown.missing_from(store, self._initial) if self._durable else []
        for counted in before:
            record = counted.record
            if self.seen(record.source, record.stamp_ns) is None:
                if record.payload:
                    self.map.add(votes_of(record, self.map.geometry))
                self._take(counted)
        if before:
            self._health.note("store_back")

    def _take(self, counted: CountedFrame) -> None:
        record = counted.record
        self._batch.append(counted)
        self._in_batch.add((record.source, record.stamp_ns))
        self._batch_bytes += len(record.payload)
        self._dirty.update(record.tiles)
        if counted.window is not None:
            self._unshown.append(counted.window)

    def _taken(self) -> list[CountedFrame]:
        """Return the frames that were counted since the last transaction, and begin a new batch."""
        batch, self._batch = self._batch, []
        self._in_batch.clear()
        self._batch_bytes = 0
        return batch

    def _trouble(self, error: LtmError, what: str) -> None:
        self.failure = str(error)
        self._pace.failed()
        self._health.trouble(cause_of(error), f"{error}; {what}")
