"""Publish the changes of a terrain map and the surface versions that it confirms; follow these in other nodes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ltm_core.base.errors import RasterError, StoreError
from ltm_core.pipeline.site_surface import confirmed_terrain, surface_versions
from ltm_core.site.site import Site
from ltm_core.surface.change import Changed, ChangeKind
from ltm_core.surface.confirmed_surface import AS_GIVEN, ConfirmedSurface, SurfaceManifest
from ltm_core.surface.surface_io import confirmed_surface
from ltm_core.surface.surface_map import SurfaceMap
from ltm_core.surface.surface_versions_io import ConfirmedTerrain
from ltm_msgs_py.cells import changed_to_msg, manifest_to_msg, msg_to_version
from ltm_msgs_py.grid import classes_to_msg
from ltm_msgs_py.json_topics import TerrainInfo
from ltm_ros.runtime.handler import Outlet
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.retry import Backoff
from ltm_ros.runtime.topics import TERRAIN_CHANGE, TERRAIN_INFO, TERRAIN_SURFACE, TERRAIN_UPDATE


class SurfaceFollower:
    """Passes each new terrain to `take` once it is loaded; until then, or if that fails, the previous one stays. The
    manifest in `folder` (empty: not used) names the version in use; a message only announces a change, so no sender can
    choose the file."""

    def __init__(self, site: Site, folder: str, take: Callable[[ConfirmedTerrain], None], health: Health) -> None:
        self._site, self._take, self._health = site, take, health
        self._versions = surface_versions(site, Path(folder)) if folder else None
        self._name = AS_GIVEN
        self._late = False
        self._follow()

    def on_message(self, message: Any) -> None:
        """Handle an announced version. Raises MessageError if it is invalid."""
        msg_to_version(message)
        self._follow()

    def tick(self) -> None:
        """Try again to load a version that failed."""
        if self._late:
            self._follow()

    def _follow(self) -> None:
        if self._versions is None:
            return
        try:
            name = self._versions.manifest().current
            if name != self._name:
                self._take(confirmed_terrain(self._site, self._versions, name))
                self._name = name
                self._health.note("surface_changed")
            self._late = False
        except (StoreError, RasterError) as error:
            self._late = True
            self._health.trouble(
                cause_of(error), f"{error}; frames are traced to {self._name or 'the original terrain'}"
            )
        self._health.gauge("surface", self._name or "as given")


class TerrainPublisher:
    """Publishes on the three topics of the node `terrain`; `health` gets the counts of cells."""

    def __init__(self, site: Site, terrain: SurfaceMap, outlet: Outlet, health: Health) -> None:
        self._site, self._map, self._outlet, self._health = site, terrain, outlet, health

    def info(self) -> None:
        """Publish the grid's position in the site's CRS, and the meaning of its values; latched."""
        geometry = self._site.in_crs(self._map.reference.geometry)
        info = TerrainInfo(
            kinds={kind.name.lower(): int(kind) for kind in ChangeKind},
            **{name: getattr(geometry, name) for name in ("x_min", "y_max", "resolution", "width", "height")},
            crs=geometry.crs or "",
            threshold=self._map.config.threshold,
            canopy_known=self._map.reference.canopy_known,
            cameras=list(self._map.cameras),
        )
        self._outlet.publish(TERRAIN_INFO, info.to_msg())

    def update(self, changed: Changed) -> None:
        """Publish cells whose change is new."""
        message = changed_to_msg(
            changed, self._map.heights_at(changed), self._map.reference.geometry, self._map.newest_ns
        )
        self._outlet.publish(TERRAIN_UPDATE, message)

    def grid(self) -> None:
        """Publish all changes in the observed window, latched; nothing if no cell was observed."""
        window = self._map.seen_window()
        if window is None:
            return
        layers = self._map.layers(window)
        self._outlet.publish(TERRAIN_CHANGE, classes_to_msg(layers.told, layers.geometry, self._map.newest_ns))
        self._health.gauge("cells.seen", int((layers.frames > 0).sum()))
        self._health.gauge("cells.judged", int(layers.observed.sum()))
        for kind in set(ChangeKind) - {ChangeKind.NONE}:
            self._health.gauge(f"cells.{kind.name.lower()}", int((layers.change == kind).sum()))


class Confirmation:
    """Makes versions of the confirmed surface in `folder`, if the site uses them. The frames' stamps alone decide when
    a version is due, so that a replay makes the same versions. If one cannot be written, the previous version stays in
    use, and it is tried again."""

    def __init__(self, site: Site, folder: str, surface: SurfaceMap, outlet: Outlet, health: Health) -> None:
        assert site.terrain is not None  # nosec B101 # tells the type checker what holds
        self._versions = surface_versions(site, Path(folder))
        self._map, self._outlet, self._health = surface, outlet, health
        self._every_ns, self._least = int(site.terrain.confirm_every * 1e9), site.terrain.threshold / 2
        self.news = False
        """Whether cells have changed since the last check for a new version."""
        self._looked_ns = 0
        self._current: ConfirmedSurface | None = None
        self._manifest = SurfaceManifest(site=site.name)
        self._pace = Backoff()
        try:
            self._read()
        except StoreError as error:
            health.trouble(cause_of(error), str(error))

    def start(self) -> None:
        """Publish the version in use."""
        self._outlet.publish(TERRAIN_SURFACE, manifest_to_msg(self._manifest))
        entry = self._manifest.entry(self._manifest.current)
        self._health.gauge("surface", "as given" if entry is None else entry.version)
        self._health.gauge("surface.changed_share", f"{0.0 if entry is None else entry.changed_share:.4f}")

    def follow(self) -> None:
        """Make a version when it is due: the first at the first change, later ones not too often."""
        since = self._map.newest_ns - self._looked_ns
        due = (since > 0 and since >= self._every_ns) or (self.news and not self._manifest.current)
        if due and self._pace.due:
            self.finish()

    def passed(self, seconds: float) -> None:
        """Advance time."""
        self._pace.passed(seconds)

    def finish(self) -> None:
        """Make a version of everything known, if it differs from the one in use."""
        try:
            if self._read():
                self.start()
            found, seen = confirmed_surface(self._map)
            before = self._in_use()
            if len(found) > 0 if before is None else found.differs_from(before, self._least):
                self._map.commit()
                self._versions.add(found, self._map.newest_ns, seen)
                self._manifest, self._current = self._versions.manifest(), found
                self.start()
            self.news, self._looked_ns = False, self._map.newest_ns
            self._pace.succeeded()
        except StoreError as error:
            self._pace.failed()
            self._health.trouble(cause_of(error), f"{error}; the previous surface stays in use")

    def _read(self) -> bool:
        """Read the manifest, because other programs may write into the folder; return whether an invalid one was moved
        aside."""
        self._manifest, told = self._versions.manifest_of_writer()
        if told:
            self._current = None
            self._health.trouble("surfaces", told)
        return bool(told)

    def _in_use(self) -> ConfirmedSurface | None:
        """Return the version in use; None without one, or if its file is lost: then it is written again."""
        entry = self._manifest.entry(self._manifest.current)
        if self._current is None and entry is not None:
            try:
                self._current = self._versions.load(entry)
            except StoreError as error:
                self._health.trouble(cause_of(error), str(error))
        return self._current
