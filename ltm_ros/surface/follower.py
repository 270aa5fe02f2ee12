"""Load the confirmed surface in the nodes that trace, between frames."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ltm_core.base.errors import RasterError, StoreError
from ltm_core.pipeline.site_surface import confirmed_terrain, surface_versions
from ltm_core.site.site import Site
from ltm_core.surface.confirmed_surface import AS_GIVEN
from ltm_core.surface.surface_versions_io import ConfirmedTerrain
from ltm_msgs_py.cells import msg_to_version
from ltm_ros.runtime.health import Health, cause_of


class SurfaceFollower:
    """Passes each new terrain to `take` once it is loaded; until then, or if that fails, the previous one stays.

    The manifest in `folder` (empty: not used) names the version in use; a message only announces a change, so no sender
    can choose the file.
    """

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
