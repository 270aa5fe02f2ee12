"""The surface map of a site, updated by posed depth images."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import Float32Array, Float64Array, Int32Array
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.storage.tile_store import Key, TileStore
from ltm_core.storage.tile_store_schema import CellChanges, FrameRecord
from ltm_core.surface.cell_layout import TILE
from ltm_core.surface.cell_update import Rules, merge
from ltm_core.surface.change import Changed, decide, margin_of
from ltm_core.surface.config import PoseErrorConfig, TerrainConfig
from ltm_core.surface.free_space import INSIDE, see_through
from ltm_core.surface.layers import SurfaceLayers, layers_of
from ltm_core.surface.observation import DepthFrame, Observer
from ltm_core.surface.observation_kernel import ObservationLimits
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.registration import Registration, register
from ltm_core.surface.tile_pool import TilePool, Window, schema_of
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND

CAMERAS = 32
"""Maximum number of cameras of a site: one bit each in every cell."""
_OWN_SIGMA = 0.25
"""Standard deviation in metres of a cell's height if it contains a crown or boulder."""
_CARVE_SIGMA = 0.5
"""Standard deviation in metres of the height of a ray that passed over a cell."""
DECIDED_TILES = 8
"""Number of tiles per side that are decided at once; with more, their rasters would be the largest part of the map's
memory."""


@dataclass(frozen=True)
class Added:
    """Effect of a frame: cells seen, tiles touched and those without room in memory, and its turn (None: not
    turned)."""

    cells: int
    tiles: int
    left_out: int
    registration: Registration | None


class SurfaceMap:
    """The estimate of every cell, and the changes that views agree on. Bare earth is never edited.

    `cameras`: all names, at most 32 (else ConfigError). `store`: of `tile_pool.schema_of` the grid in the site's CRS;
    None: what does not fit the memory for cells is kept compressed. `curvature`, `refraction`: as for the tracer.
    `gone`: (256,) log odds by label id that what stood in a cell is gone; None: labels are not used.
    `assumed_pose_error`: of frames without a covariance."""

    def __init__(
        self,
        reference: Reference,
        config: TerrainConfig,
        cameras: Sequence[str],
        store: TileStore | None = None,
        curvature: bool = True,
        refraction: float = 0.13,
        gone: Float32Array | None = None,
        assumed_pose_error: PoseErrorConfig | None = None,
    ) -> None:
        if len(cameras) > CAMERAS:
            raise ConfigError(f"a terrain supports {CAMERAS} cameras, this site has {len(cameras)}; split the site")
        self.reference, self.config, self.cameras = reference, config, tuple(cameras)
        self._assumed_covariance = (assumed_pose_error or PoseErrorConfig()).covariance()
        # What lies beyond the map is not its business: where no ground of it is, anything that is seen stands free.
        self._tracer = TerrainTracer(Dem(reference.surface, reference.geometry), curvature, refraction, NOTHING_BEYOND)
        self._limits = ObservationLimits(
            config.min_range, config.max_range, config.confidence, config.threshold / 2, config.tallest, _OWN_SIGMA,
            config.threshold,
        )  # fmt: skip
        self._observer = Observer(reference, self._tracer, self._limits, config.columns, config.views_mb, gone)
        self._rules = Rules(
            config.confidence, config.reference_sigma**2, config.independent_after, config.settle, config.memory,
            config.lasting, config.threshold, _CARVE_SIGMA**2, config.threshold / INSIDE, config.repeated_error_share,
        )  # fmt: skip
        store = TileStore.in_memory(schema_of(reference.geometry)) if store is None else store
        self._pool = TilePool(store, TilePool.capacity_of(config.cache_mb), reference.canopy_known)
        self._turns: dict[str, tuple[Pose, Float64Array, int, Registration | None]] = {}
        """By camera: pose, covariance and stamp of its last registered frame, and the turn that was found."""
        self._undecided: set[Key] = set(self._pool.known_keys)
        self.newest_ns = store.newest_ns() or 0

    @property
    def uncommitted(self) -> int:
        """Return the frames whose effect is not in the store yet."""
        return len(self._pool.frames)

    @property
    def tiles_in_memory(self) -> int:
        return self._pool.in_memory

    def counted(self, source: str, stamp_ns: int) -> bool:
        """Return whether a frame has been counted already."""
        return self._pool.counted(source, stamp_ns)

    def add(self, frame: DepthFrame) -> Added:
        """Take a frame in. Raises ConfigError for an unknown camera, PoseError as the tracer does, StoreError."""
        if frame.source not in self.cameras:
            raise ConfigError(f"no camera {frame.source!r}; cameras: {', '.join(self.cameras)}")
        config, reference, pool = self.config, self.reference, self._pool
        covariance = self._assumed_covariance if frame.covariance is None else frame.covariance
        turned = self._registered(frame, covariance) if config.register_frames else None
        if turned is not None:
            frame, covariance = replace(frame, pose=turned.pose), turned.covariance
        sums = self._observer.observe(frame, covariance)
        keys, left_out = self._nearest(sums.seen_tiles, frame)
        pool.require(keys)
        bit, seconds = 1 << self.cameras.index(frame.source), frame.stamp_ns // 1_000_000_000
        cells = merge(pool.cells, sums, pool.slots.ravel(), seconds, bit, self._rules)
        camera, pixels = self._observer.sampled(frame), self._observer.pixels(frame)
        grid, reach = (reference.surface, reference.geometry), (config.min_range, config.max_range)
        given = pool.cells, pool.places(), *grid, camera, frame.pose, pixels
        see_through(*given, seconds, bit, self._rules, reach)
        pool.touched(keys)
        pool.frames.append(FrameRecord(frame.source, frame.stamp_ns, keys))
        self._undecided.update(keys)
        self.newest_ns = max(self.newest_ns, frame.stamp_ns)
        return Added(int(cells), len(keys), left_out, turned)

    def decide(self) -> Changed:
        """Update the changes where frames have touched the map since the last call; return the new ones."""
        found = Changed.none()
        while self._undecided:
            top, left = min(self._undecided)
            near = range(left - DECIDED_TILES + 1, left + DECIDED_TILES)
            core = {key for key in self._undecided if key[0] < top + DECIDED_TILES and key[1] in near}
            left = min(key[1] for key in core)
            core = {key for key in core if key[1] < left + DECIDED_TILES}
            found = found.joined(self._decide(core))
            self._undecided -= core
        return found

    def commit(self, last: bool = False) -> int:
        """Write what has changed to the store; how many tiles. Raises StoreError. `last`: before it is closed."""
        self.decide()
        return self._pool.commit(last)

    def layers(self, window: Window | None = None) -> SurfaceLayers:
        """Return the height, sigma, change and age of a window (row, col, height, width); default: of the whole
        grid."""
        return layers_of(self._pool, self.reference, window or (0, 0, *self.reference.geometry.shape), self._rules)

    def close(self) -> None:
        """Close its store; the map cannot be used afterwards. Idempotent."""
        self._pool.store.close()

    def seen_window(self) -> Window | None:
        """Return the smallest window (row, col, height, width) of whole tiles that any frame has touched."""
        keys = self._pool.known_keys
        return self._window(keys) if keys else None

    def heights_at(self, changed: Changed) -> Float32Array:
        """Return the updated surface at changed cells, (N,) metres."""
        base = np.zeros(len(changed.rows), np.float32)
        keys = np.stack([changed.rows // TILE, changed.cols // TILE], axis=-1)
        for key in {(int(r), int(c)) for r, c in keys}:
            tile, inside = self._pool.peek(key), (keys == key).all(axis=1)
            if tile is not None:
                base[inside] = tile["base"][changed.rows[inside] % TILE, changed.cols[inside] % TILE]
        surface = self.reference.surface[changed.rows, changed.cols]
        return np.asarray(surface + np.nan_to_num(base) + changed.shift, np.float32)

    def _registered(self, frame: DepthFrame, covariance: Float64Array) -> Registration | None:
        """Return the turn of a camera, which is kept for a time while it does not move: one more image would add
        little, and its reference is traced already."""
        if frame.source in self._turns:
            pose, given, stamp_ns, turn = self._turns[frame.source]
            recent = 0 <= frame.stamp_ns - stamp_ns < int(self.config.independent_after * 1e9)
            if recent and pose == frame.pose and np.array_equal(given, covariance):
                return turn
        turn = register(frame, covariance, self.reference, self._tracer, self._limits)
        self._turns[frame.source] = frame.pose, covariance, frame.stamp_ns, turn
        return turn

    def _nearest(self, tiles: Int32Array, frame: DepthFrame) -> tuple[list[Key], int]:
        """Return these tiles, the nearest of them where there are more than fit into memory."""
        rows, cols = np.divmod(tiles, self._pool.slots.shape[1])
        row, col = self.reference.geometry.to_grid(frame.pose.position[0], frame.pose.position[1])
        nearest = np.argsort(np.hypot(rows - row / TILE, cols - col / TILE), kind="stable")
        kept = np.sort(nearest[: self._pool.capacity])
        return [(int(rows[i]), int(cols[i])) for i in kept], len(tiles) - len(kept)

    def _window(self, keys: Iterable[Key], margin: int = 0) -> Window:
        """Return the smallest window over tiles, and over `margin` tiles around them."""
        (top, left), (bottom, right) = ([edge(k[i] for k in keys) for i in (0, 1)] for edge in (min, max))
        row, col = max(top - margin, 0) * TILE, max(left - margin, 0) * TILE
        height, width = self.reference.geometry.shape
        down, across = min((bottom + margin + 1) * TILE, height), min((right + margin + 1) * TILE, width)
        return row, col, down - row, across - col

    def _decide(self, core: set[Key]) -> Changed:
        assert margin_of(self.reference.geometry.resolution) <= TILE  # nosec B101 # of constants
        window = self._window(core, 1)
        keys, inside = sorted(core), np.zeros(window[2:], np.bool_)
        corners = [(row * TILE - window[0], col * TILE - window[1]) for row, col in keys]
        parts = [(slice(row, row + TILE), slice(col, col + TILE)) for row, col in corners]
        for part in parts:
            inside[part] = True
        changed, fields = decide(self._pool, self.reference, window, inside, self.config, self._rules)
        for part, slot in zip(parts, self._pool.require(keys), strict=True):
            h, w = inside[part].shape
            records = self._pool.cells.records[slot].reshape(TILE, TILE)[:h, :w]
            for name, values in fields.items():
                records[name] = values[part]
        self._pool.touched(keys)
        if len(changed.rows):
            cells = changed.rows, changed.cols, changed.before, changed.kind
            self._pool.changes.append(CellChanges("change", self.newest_ns, *cells))
        return changed
