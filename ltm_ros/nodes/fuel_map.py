"""fuel_map: fuse the votes of all cameras of a site into its fuel map, and store it."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ltm_core.base.errors import ConfigError, MessageError, StoreError
from ltm_core.base.resources import config_path
from ltm_core.base.types import BoolArray
from ltm_core.fuel.class_map import write_fuel_map
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.label_errors import LabelErrors
from ltm_core.fuel.life_form import life_form_labels
from ltm_core.pipeline.kernels import compile_kernels
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.pipeline.site_surface import terrain_grid
from ltm_core.pipeline.stored_fuel import STORE_FILE, fuel_schema
from ltm_core.site.networks import labels_state, with_live_record
from ltm_core.site.site_io import load_site
from ltm_core.storage.disk_io import make_folder
from ltm_core.storage.tile_store import TileStore
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.json_topics import FuelMapAnswer, FuelMapInfo, msg_to_model
from ltm_msgs_py.pointcloud import msg_to_votes
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.fuel_map.export import write_landscapes
from ltm_ros.fuel_map.persistence import Counting, FuelMapPersistence
from ltm_ros.fuel_map.self_measurement import DriftWatch, SelfMeasurement
from ltm_ros.fuel_map.services import FuelMapConfig, FuelPublisher, answer, burned, region_of
from ltm_ros.fuel_map.terrain_changes import SurfaceListener
from ltm_ros.runtime import topics
from ltm_ros.runtime.handler import Handler, NodeType, Outlet, Topic
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.retry import LAST_TRIES_S
from ltm_ros.runtime.stamp_check import StampCheck
from ltm_ros.runtime.topics import of_cameras

BURN_SOURCE = "fuel_map/burn"
"""Source name of burns in the store; no camera can have this name."""


class FuelMapHandler(Handler[FuelMapConfig]):
    """Publishes changes and the whole map (latched) after they are stored.

    Live, at each `tick`, twice a second; in an offline replay, after each frame."""

    publications = (*FuelPublisher.publications, topics.FUEL_MAP_INFO, topics.FUEL_MAP_ANSWER)

    def __init__(self, config: FuelMapConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        if (folder := config.beside_site(config.folder)) is not None:
            make_folder(folder)  # only if its parent exists, so that a missing disk is noticed
        self._folder = folder
        self._site = with_live_record(load_site(config.site), self._folder)
        self._labels = LabelSet.load(config_path(self._site.labels))
        self._classes = life_form_labels(self._labels)
        dem = self._site.open_dem()
        self._geometry = self._site.fuel_geometry(dem)
        self._measuring = SelfMeasurement(self._site, self._geometry, self._labels, self._folder)
        self._drift = DriftWatch(self._labels, self._folder, health)
        self._measured: LabelErrors | None = None
        self.persistence = FuelMapPersistence(self._empty, self._open_store, health, durable=folder is not None)
        self._publisher = FuelPublisher(outlet, health, self.persistence, self._geometry, dem)
        self._stamps = StampCheck(outlet.now_ns, health, config.max_ahead, config.max_behind)
        self._surface: SurfaceListener | None = None
        if self._site.terrain is not None:
            grid = terrain_grid(dem.geometry, self._site.terrain.resolution)
            self._surface = SurfaceListener(grid, self.persistence, health, self._stamps.ahead)
        self._models: dict[str, str] = {}
        self._region: tuple[BoolArray, int] | None = None
        self._paced = False

    @property
    def subscriptions(self) -> Mapping[Topic, Callable[[Any], None]]:
        found = of_cameras(self._site, {topics.FUEL_VOTES: self.on_votes, topics.LABELS_INFO: self.on_label_info})
        found |= {topics.FUEL_MAP_QUERY: self.on_query, topics.FUEL_MAP_REGION: self.on_region}
        if self._surface is not None:
            found |= {topics.TERRAIN_UPDATE: self._surface.on_update, topics.TERRAIN_CHANGE: self.on_surface_change}
        return found

    @property
    def services(self) -> Mapping[str, Callable[[], str]]:
        return {"fuel_map/save": self.save, "fuel_map/export": self.export, "fuel_map/burn": self.burn}

    def start(self) -> None:
        self._send_info()
        self._publisher.send_map()
        self._publisher.announce([])
        compile_kernels("fuel_map", self._site)

    @property
    def _reliability(self) -> str:
        return labels_state(self._site) if self._measured is None else self._measured.state

    def _send_info(self) -> None:
        geometry, state = self._site.in_crs(self._geometry), self._reliability
        info = FuelMapInfo(
            **self._classes.info(),
            crs=geometry.crs or "",
            x_min=geometry.x_min,
            y_max=geometry.y_max,
            origin=self._site.origin,
            growth={"steepest_deg": self._site.fuel.steepest_deg},
            labels_measured=state,
        )
        self.health.gauge("labels", state)
        self.outlet.publish(topics.FUEL_MAP_INFO, info.to_msg())

    def on_votes(self, camera: str, message: Any) -> None:
        stamp = stamp_of(message)
        if self._stamps.refuses(f"votes of {camera}", stamp):
            return
        votes, model = msg_to_votes(message, self._geometry, self._labels.names, camera), self._models.get(camera, "")
        counting = self.persistence.count(votes, model)
        if counting is Counting.COUNTED:
            self._measuring.take(votes)
            self._drift.take(votes, model, self.persistence.shown)
        elif counting is Counting.DUPLICATE:
            self.health.drop("duplicate", f"duplicate votes of {camera} of stamp {stamp} ns; counted once")
        elif counting is Counting.TOO_OLD:
            why = "are older than the remembered stamps; check the camera's clock"
            self.health.drop("too_old", f"votes of {camera} of stamp {stamp} ns {why}")
        elif counting is Counting.EMPTY:
            self.health.note("empty_votes")

    def on_label_info(self, camera: str, message: Any) -> None:
        """Store which network labels a camera's images, with its frames."""
        self._models[camera] = msg_to_model(message)

    def on_query(self, message: Any) -> None:
        if message.header.frame_id != "map":
            raise MessageError(f"the query is in frame {message.header.frame_id!r}, expected 'map'")
        point = message.point
        found = answer(self.persistence.map, self.persistence.store, self._classes, float(point.x), float(point.y))
        asked = {"x": float(point.x), "y": float(point.y), "stamp_ns": stamp_of(message)}
        self.outlet.publish(topics.FUEL_MAP_ANSWER, FuelMapAnswer.model_validate(asked | found).to_msg())

    def on_region(self, message: Any) -> None:
        self._region = region_of(message, self._geometry)

    def on_surface_change(self, message: Any) -> None:
        """Apply terrain changes (removed or grown) to the map and the store, then publish them."""
        assert self._surface is not None  # nosec B101 # tells the type checker what holds
        if self._surface.on_change(message):
            self._settle(write_tiles=True)

    def idle(self) -> None:
        if not self._paced:
            self._measure(at_once=True)
            self._settle()

    def tick(self, waited: float) -> None:
        self._paced = True
        self.persistence.wait(waited)
        if self._surface is not None:
            self._surface.retry()
        self._measure(at_once=False)
        self._settle()
        self._publisher.tick(waited)

    def finish(self) -> None:
        """Store the remaining frames. Raises StoreError if that fails; then they are lost."""
        self._measure(at_once=True)
        self._drift.save()
        self._publisher.announce(self.persistence.close())
        self._publisher.send_map()
        self._publisher.send_cells()
        try:
            if self.config.export_path:
                self._write()
        finally:
            if lost := self.persistence.unsaved_frames:
                raise StoreError(
                    f"{lost} unacknowledged frames are lost: they could not be stored within {LAST_TRIES_S:.0f} s "
                    f"more ({self.persistence.failure}); send them again"
                )

    def save(self) -> str:
        """Write the map to the configured file. Raises ConfigError without one."""
        self._settle(write_tiles=True)
        return f"fuel map of {self.persistence.saved_frames} frames written to {self._write().name}"

    def export(self) -> str:
        """Write landscapes for fire models into the node's folder. Raises ConfigError without one."""
        if self._folder is None:
            raise ConfigError("no folder is configured for landscapes: set the parameter folder")
        paths = write_landscapes(self.persistence.map, self._site, self._folder, self._folder)
        return f"{' and '.join(path.name for path in paths)} written, as of stamp {self.persistence.map.newest_ns} ns"

    def burn(self) -> str:
        """Mark the last region of `fuel_map/region` as burned at its stamp, or now; it is used once."""
        if not self.config.allow_burn:
            raise ConfigError(
                "fuel_map/burn is disabled: set `allow_burn: true` under `nodes: fuel_map:` in the site file, and "
                "restart the node"
            )
        if self._region is None:
            raise ConfigError("no region is selected: first publish its corners on fuel_map/region, in the frame map")
        (cells, stamp), self._region = self._region, None
        stamp = stamp or self.outlet.now_ns() or self.persistence.map.newest_ns
        if self._stamps.ahead("the burned region", stamp):
            raise MessageError(f"the burn stamp {stamp} ns is in the future of this node's clock")
        tiles, window = burned(self.persistence.map, cells, stamp)
        self.persistence.replace_tiles(tiles, BURN_SOURCE, stamp, window)
        self._settle(write_tiles=True)
        self._publisher.send_map()
        return f"{int(cells.sum())} cells burned at stamp {stamp} ns"

    def _measure(self, at_once: bool) -> None:
        """Measure unmeasured labels when there are enough frames, and count these again with the result."""
        if not self._measuring.wanted or self.persistence.store is None:
            return
        found = self._measuring.measured(at_once)
        if self._measuring.failure:
            self.health.gauge("labels", f"{self._reliability} ({self._measuring.failure})")
        if found is not None:
            record, frames = found
            self._site, self._measured = with_live_record(self._site, self._folder), record.errors()
            self.persistence.restart(frames)
            self._send_info()

    def _settle(self, write_tiles: bool = False) -> None:
        self._publisher.announce(self.persistence.settle(write_tiles))

    def _write(self) -> Path:
        name = self.config.export_path or (self._folder / "fuel_map.tif" if self._folder is not None else "")
        life_form, grid = self.persistence.map.layers().life_form, self._site.in_crs(self._geometry)
        return write_fuel_map(name, life_form, grid, self._classes, {"labels": self._reliability})

    def _empty(self) -> EvidenceMap:
        return site_evidence_map(self._site, self._geometry, self._labels, self._measured)

    def _open_store(self) -> TileStore:
        schema, folder = fuel_schema(self._site, self._geometry), self._folder
        return TileStore.in_memory(schema) if folder is None else TileStore.open(folder / STORE_FILE, schema)


NODE = NodeType("fuel_map", FuelMapConfig, FuelMapHandler)
run_node(NODE, __name__)
