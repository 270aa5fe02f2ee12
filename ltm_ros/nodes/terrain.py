"""terrain: update a site's surface map from measured depth where several views agree."""

import time
from collections.abc import Sequence
from functools import partial
from typing import Any

from pydantic import Field

from ltm_core.base.errors import ConfigError, StoreError
from ltm_core.pipeline.kernels import compile_kernels
from ltm_core.pipeline.site_surface import STORE_FILE, UNCOMMITTED, SiteTerrain
from ltm_core.site.site_io import load_site
from ltm_core.storage.disk_io import make_folder
from ltm_core.storage.tile_store import TileStore
from ltm_core.storage.tile_store_schema import StoreSchema
from ltm_core.surface.change import Changed
from ltm_msgs_py.image import msg_to_array, msg_to_depth
from ltm_msgs_py.pose import msg_to_covariance, msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.fuel_map.surface_confirmation import Confirmation, TerrainPublisher
from ltm_ros.runtime import topics
from ltm_ros.runtime.handler import NodeType, Outlet, Topic
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.retry import LAST_PAUSE_S, LAST_TRIES_S, Backoff
from ltm_ros.runtime.stamp_check import StampCheck, StampLimits
from ltm_ros.runtime.stamp_join import JoinConfig, JoiningHandler, Part, StampJoin
from ltm_ros.runtime.topics import of_camera

GRID_CELLS_PER_S = 1_000_000
"""Cells per second of the latched grid of changes: a large grid is published less often."""
_WAITING = 6
"""Maximum number of frames per camera that wait for their parts, and of labels that wait for their frame."""


class TerrainNodeConfig(JoinConfig, StampLimits):
    max_wait: float = Field(120.0, gt=0)
    """Seconds for which a frame's pose waits for its measured depth, which may have waited in `topodepth` before."""
    folder: str = ""
    """Folder in which the surface is kept between runs, relative to the site file. Empty: not kept. Never set by a
    message."""
    commit_every: float = Field(10.0, gt=0)
    """Seconds of frames that a power cut may lose."""
    surfaces: str = ""
    """Folder for the confirmed surfaces that depth is traced to; empty: none. The graph sets it."""
    depth_from_elsewhere: bool = False
    """Whether `measured/depth` and `measured/sigma` come from outside this graph, such as a range finder,
    at any size."""


class TerrainHandler(JoiningHandler[TerrainNodeConfig]):
    """Publishes changed cells after they are confirmed and stored, and the whole grid of changes (latched)."""

    publications: Sequence[Topic] = (topics.TERRAIN_UPDATE, topics.TERRAIN_CHANGE, topics.TERRAIN_INFO)

    def __init__(self, config: TerrainNodeConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        self._site = site = load_site(config.site)
        if site.terrain is None:
            raise ConfigError(f"{config.site}: has no section `terrain`; add one (`terrain: {{}}` uses the defaults)")
        if not site.depth_model and not config.depth_from_elsewhere:
            raise ConfigError(
                f"{config.site}: terrain needs measured depth, because traced depth agrees with the DEM by "
                "construction: set `depth_model` to a depth network, or set the node's depth_from_elsewhere"
            )
        self._terrain = SiteTerrain(site, self._open_store)
        self._store, self._map = self._terrain.store, self._terrain.map
        self._publisher = TerrainPublisher(site, self._map, outlet, health)
        self._confirmation: Confirmation | None = None
        if config.surfaces:
            self._confirmation = Confirmation(site, config.surfaces, self._map, outlet, health)
            self.publications = (*self.publications, topics.TERRAIN_SURFACE)
        self._stamps = StampCheck(outlet.now_ns, health, config.max_ahead, config.max_behind)
        self._joins = [self._join_of(camera) for camera in site.cameras]
        self._paced = self._dirty = self._undecided = False
        self._untold = Changed.none()
        self._since_grid = self._since_commit = 0.0
        self._pace = Backoff()
        compile_kernels("terrain", site)

    def _join_of(self, camera: str) -> StampJoin:
        at = partial(of_camera, self._site.name, camera)
        parts = [
            Part("depth", topic=at(topics.MEASURED_DEPTH)),
            Part("sigma", topic=at(topics.MEASURED_SIGMA)),
            Part("info", topic=at(topics.POSED_CAMERA_INFO)),
            Part("pose", topic=at(topics.POSED_POSE)),
            Part("labels", wait_s=0.0, remembered=_WAITING, topic=at(topics.LABELS_IMAGE)),
        ]
        take, wait = partial(self._take, camera), self.config.max_wait
        return StampJoin(parts, take, self.health, _WAITING, max_wait=wait, camera=camera)

    def start(self) -> None:
        self._publisher.info()
        self._publish_grid()
        if self._confirmation is not None:
            self._confirmation.start()

    def idle(self) -> None:
        if not self._paced:
            self._store_what_is_due()

    def tick(self, waited: float) -> None:
        super().tick(waited)
        self._paced = True
        self._since_grid += waited
        self._since_commit += waited
        self._pace.passed(waited)
        if self._confirmation is not None:
            self._confirmation.passed(waited)
        if self._pace.due:
            self._store_what_is_due()
        window = self._map.seen_window()
        if self._dirty and window and self._since_grid >= window[2] * window[3] / GRID_CELLS_PER_S:
            self._publish_grid()

    def end_of_day(self) -> None:
        """Publish changes before the next day's frames, so that the fuel map applies them in order."""
        self._store_what_is_due()
        if self._dirty:
            self._publish_grid()

    def finish(self) -> None:
        """Store the remaining frames. Raises StoreError if that fails; then they are lost."""
        try:
            super().finish()
            self._store_the_last()
            if self._confirmation is not None:
                self._confirmation.finish()
        finally:
            self._publish_grid()
            self._store.close()

    def _take(self, camera: str, depth: Any, sigma: Any, info: Any, pose: Any, labels: Any) -> None:
        stamp = stamp_of(depth)
        if self._stamps.refuses(f"a frame of {camera}", stamp):
            return
        if self._map.counted(camera, stamp):
            self.health.drop("duplicate", f"duplicate frame of {camera} of stamp {stamp} ns; counted once")
            return
        depths, where = (msg_to_depth(depth), msg_to_depth(sigma)), (msg_to_camera(info), msg_to_pose(pose, "map"))
        labelled = None if labels is None else msg_to_array(labels, ("mono8",))
        added = self._terrain.add(*depths, *where, stamp, camera, msg_to_covariance(pose), labelled)
        self._undecided = True
        self.health.gauge("frames", self._store.frame_count() + self._map.uncommitted)
        self.health.gauge("tiles_in_memory", self._map.tiles_in_memory)
        if added.cells == 0:
            self.health.note("nothing_seen")
        if added.left_out:
            self.health.note("tiles_left_out")
        if added.registration is not None:
            self.health.gauge(f"turned_deg.{camera}", f"{added.registration.turned_deg:.3f}")

    def _store_what_is_due(self) -> None:
        """Store due frames. Without the disk, they stay in memory and are tried again."""
        try:
            self._settle()
            due = self._since_commit >= self.config.commit_every or self._map.uncommitted >= UNCOMMITTED
            if due and self._map.uncommitted:
                self._map.commit()
                self._since_commit = 0.0
            if self._confirmation is not None:
                self._confirmation.follow()
            self._pace.succeeded()
            if self._store.strain:
                self.health.trouble("store", self._store.strain)
        except StoreError as error:
            self._pace.failed()
            self.health.trouble(cause_of(error), f"{error}; {self._map.uncommitted} frames are in memory only")

    def _store_the_last(self) -> None:
        until = time.monotonic() + LAST_TRIES_S
        while True:
            try:
                return self._settle(last=True)
            except StoreError as error:
                if time.monotonic() >= until:
                    lost = f"{self._map.uncommitted} frames with unpublished changes are lost"
                    why = f"{LAST_TRIES_S:.0f} s more did not help ({error})"
                    raise StoreError(f"{lost}: {why}; send them again") from error
                time.sleep(LAST_PAUSE_S)

    def _settle(self, last: bool = False) -> None:
        """Compute the changes of the frames since the last call; changes are stored before they are published.

        `last`: write everything, because no more frames come. Raises StoreError."""
        if self._undecided:
            self._undecided, self._dirty = False, True
            self._untold = self._untold.joined(self._map.decide())
        if last or len(self._untold.rows):
            self._map.commit(last)
        if len(self._untold.rows):
            self._publisher.update(self._untold)
            self._untold = Changed.none()
            if self._confirmation is not None:
                self._confirmation.news = True

    def _publish_grid(self) -> None:
        self._dirty, self._since_grid = False, 0.0
        self._publisher.grid()

    def _open_store(self, schema: StoreSchema) -> TileStore:
        if (folder := self.config.beside_site(self.config.folder)) is None:
            return TileStore.in_memory(schema)
        make_folder(folder)
        return TileStore.open(folder / STORE_FILE, schema)


NODE = NodeType("terrain", TerrainNodeConfig, TerrainHandler)
run_node(NODE, __name__)
