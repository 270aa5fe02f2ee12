"""Apply the terrain's changes to the fuel map: check them, match them to fuel cells, apply each once."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ltm_core.base.errors import MessageError
from ltm_core.base.types import UInt8Array
from ltm_core.fuel.evidence import Window
from ltm_core.fuel.surface_change import SOURCE
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pipeline.stored_fuel import SurfaceMoves, take_news
from ltm_core.surface.change import ChangeKind
from ltm_core.surface.layers import UNSEEN
from ltm_msgs_py.cells import msg_to_changed
from ltm_msgs_py.grid import msg_to_classes, tile_window
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.fuel_map.persistence import FuelMapPersistence
from ltm_ros.runtime.health import Health

_POINT_BYTES = 64
"""Maximum bytes of a changed cell in a message."""


class SurfaceListener:
    """Applies `terrain/update` (how far cells moved) and `terrain/change` (the state of all) to the fuel map.
    `terrain/change` is compared with the recorded state of the fuel cells, so that a repeated message changes nothing.
    `grid`: of the terrain node, in the map frame. `refuse_future`: raises or counts a stamp that is ahead; True if the
    message must be rejected."""

    def __init__(
        self,
        grid: GridGeometry,
        persistence: FuelMapPersistence,
        health: Health,
        refuse_future: Callable[[str, int], bool],
    ) -> None:
        self._grid, self._persistence, self._health, self._refuse_future = grid, persistence, health, refuse_future
        self._moves = SurfaceMoves(grid)
        self._newest = 0
        self._waiting: tuple[int, UInt8Array, Window] | None = None
        """Stamp, kinds and window of the newest state, until the store is open."""

    def on_update(self, message: Any) -> None:
        """Record how far cells have moved whose change is new. Raises MessageError and takes nothing of it."""
        self._check("terrain update", message, int(message.height) * int(message.width), _POINT_BYTES)
        if self._refuse_future("the terrain's update", stamp_of(message)):
            return
        changed, places = msg_to_changed(message)
        x, y = self._grid.to_map(changed.rows, changed.cols)
        with np.errstate(invalid="ignore"):
            placed = np.hypot(places[:, 0] - x, places[:, 1] - y) <= 0.25 * self._grid.resolution
        good = self._grid.contains(changed.rows, changed.cols) & placed & np.isfinite(changed.shift)
        if not good.all():
            first = int(np.argmin(good))
            raise MessageError(
                f"terrain update: point {first} at ({places[first, 0]}, {places[first, 1]}), cell "
                f"({changed.rows[first]}, {changed.cols[first]}), kind {changed.kind[first]}, shift "
                f"{changed.shift[first]} m: not a change on this site's terrain grid of {self._grid.shape} cells"
            )
        self._moves.take(changed)

    def on_change(self, message: Any) -> int:
        """Apply the kinds of change of a window; return the number of changed fuel cells. Raises MessageError,
        StoreError."""
        self._check("terrain change", message, int(message.info.width) * int(message.info.height), 1)
        stamp = stamp_of(message)
        if self._refuse_future("the terrain's changes", stamp):
            return 0
        if stamp < self._newest:
            self._health.drop("too_old", f"terrain changes of stamp {stamp} ns came after those of {self._newest} ns")
            return 0
        kinds, window = msg_to_classes(message)
        place = tile_window(window, self._grid)
        strange = (kinds > max(ChangeKind)) & (kinds != UNSEEN)
        if strange.any():
            row, col = np.argwhere(strange)[0]
            raise MessageError(
                f"terrain change: invalid kind {kinds[row, col]} at row {row}, col {col}; valid are 0 to 3"
            )
        self._newest, self._waiting = stamp, (stamp, kinds, place)
        return self.retry()

    def retry(self) -> int:
        """Apply what waits for the store; return 0 if nothing does, or the store still fails."""
        if self._waiting is None or self._persistence.store is None:
            return 0
        (stamp, kinds, window), self._waiting = self._waiting, None
        news = self._moves.news(kinds, window, self._persistence.map)
        if len(news):
            taken = take_news(self._persistence.map, news, stamp)
            self._persistence.replace_tiles(taken.tiles, SOURCE, stamp, taken.window, [taken.change])
            self._health.note("terrain_changes")
        return len(news)

    def _check(self, what: str, message: Any, count: int, bytes_each: int) -> None:
        """Raise MessageError for a message of another frame, or of more cells than the terrain has."""
        cells = self._grid.width * self._grid.height
        if count > cells or len(message.data) > cells * bytes_each:
            raise MessageError(f"{what} has {count} cells in {len(message.data)} bytes; this site has {cells} cells")
        if message.header.frame_id != "map":
            raise MessageError(f"{what} is in frame {message.header.frame_id!r}, expected 'map'")
