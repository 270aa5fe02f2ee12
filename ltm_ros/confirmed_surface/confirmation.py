"""The terrain node's side of the confirmed surface: when a version is made, told of, and taken back."""

from __future__ import annotations

from pathlib import Path

from ltm_core.confirmed_terrain import surface_versions
from ltm_core.errors import StoreError
from ltm_core.raster.confirmed_surface import ConfirmedSurface
from ltm_core.raster.surface_versions_io import SurfaceManifest
from ltm_core.site import Site
from ltm_core.terrain.confirmation import confirmed_surface
from ltm_core.terrain.surface_map import SurfaceMap
from ltm_msgs_py.confirmed_surface import manifest_to_msg
from ltm_ros.runtime.handler import Outlet
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.retry import RetryPace
from ltm_ros.runtime.topics import TERRAIN_SURFACE


class Confirmation:
    """Makes versions of what a surface map has confirmed, in the folder `folder` of a site that asks for them.

    When one is due is told by the frames' stamps alone, so that a replay makes the same versions. What a version holds
    is in the map's store before. Where one cannot be written, the version before still counts, and it is tried again.
    """

    def __init__(self, site: Site, folder: str, surface: SurfaceMap, outlet: Outlet, health: Health) -> None:
        assert site.terrain is not None  # nosec B101 # tells the type checker what holds
        self._versions = surface_versions(site, Path(folder))
        self._map, self._outlet, self._health = surface, outlet, health
        self._every_ns, self._least = int(site.terrain.confirm_every * 1e9), site.terrain.threshold / 2
        self.news = False
        """Whether cells have changed since it was last looked for a version."""
        self._looked_ns = 0
        self._current: ConfirmedSurface | None = None
        self._manifest = SurfaceManifest(site=site.name)
        self._read()
        self._pace = RetryPace()

    def start(self) -> None:
        """Tell of the version that counts."""
        self._tell()

    def follow(self) -> None:
        """Make a version where one is due: the first as soon as there is change, and others not too often."""
        since = self._map.newest_ns - self._looked_ns
        due = (since > 0 and since >= self._every_ns) or (self.news and not self._manifest.current)
        if due and self._pace.due:
            self._try()

    def passed(self, seconds: float) -> None:
        """So much time has gone by."""
        self._pace.passed(seconds)

    def finish(self) -> None:
        """Have the last of what is known count for those that come later."""
        self._try()

    def confirm(self) -> str:
        """Make what the map knows now count, also where a version was taken back. Raises StoreError."""
        found, seen = confirmed_surface(self._map)
        self._add(found, seen)
        return f"surface {self._manifest.current} counts: {len(found)} of {seen} cells seen have changed"

    def take_back(self) -> str:
        """Make the version before count, and hold it until `confirm`. Raises StoreError."""
        self._manifest, self._current = self._versions.take_back(), None
        self._tell()
        now = f"surface {self._manifest.current}" if self._manifest.current else "the terrain as it was given"
        return f"{now} counts again, and is held until terrain/confirm is called"

    def _read(self) -> None:
        """What counts, from the folder. Where that cannot be, nothing does until a version is made; the node lives."""
        try:
            self._manifest, told = self._versions.manifest_of_writer()
        except StoreError as error:
            told, cause = str(error), cause_of(error)
        else:
            cause = "surfaces"
        if told:
            self._health.trouble(cause, told)

    def _try(self) -> None:
        try:
            self._put_aside_what_is_broken()
            self._renew()
            self._pace.succeeded()
        except StoreError as error:
            self._pace.failed()
            self._health.trouble(cause_of(error), f"{error}; the surface before still counts")

    def _put_aside_what_is_broken(self) -> None:
        """Somebody may write into the folder while the node lives."""
        manifest, told = self._versions.manifest_of_writer()
        if told:
            self._health.trouble("surfaces", told)
            self._manifest, self._current = manifest, None
            self._tell()

    def _renew(self) -> None:
        """Make a version where there is anything new; none while one is held."""
        if self._manifest.held:
            return
        found, seen = confirmed_surface(self._map)
        before = self._counting()
        if len(found) > 0 if before is None else found.differs_from(before, self._least):
            self._add(found, seen)
        self.news, self._looked_ns = False, self._map.newest_ns

    def _counting(self) -> ConfirmedSurface | None:
        """What counts now; None where nothing does, or its file is lost: it is then written anew."""
        entry = self._manifest.entry(self._manifest.current)
        if self._current is None and entry is not None:
            try:
                self._current = self._versions.load(entry)
            except StoreError as error:
                self._health.trouble(cause_of(error), str(error))
        return self._current

    def _add(self, found: ConfirmedSurface, seen: int) -> None:
        self._put_aside_what_is_broken()
        self._map.commit()
        self._versions.add(found, self._map.newest_ns, seen)
        self._manifest, self._current = self._versions.manifest(), found
        self._tell()

    def _tell(self) -> None:
        self._outlet.publish(TERRAIN_SURFACE, manifest_to_msg(self._manifest))
        entry = self._manifest.entry(self._manifest.current)
        self._health.gauge("surface", "as given" if entry is None else entry.version)
        self._health.gauge("surface.changed_share", f"{0.0 if entry is None else entry.changed_share:.4f}")
