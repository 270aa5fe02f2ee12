"""What a terrain map says: where its grid lies, which cells have changed, and the grid of all changes."""

from __future__ import annotations

import json

from std_msgs.msg import String

from ltm_core.site import Site
from ltm_core.terrain import SurfaceMap
from ltm_core.terrain.change import Changed, ChangeKind
from ltm_msgs_py.terrain import change_to_msg, changed_to_msg
from ltm_ros.runtime.handler import Outlet
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import TERRAIN_CHANGE, TERRAIN_INFO, TERRAIN_UPDATE


class TerrainPublisher:
    """Publishes on the three topics of the node `terrain`; `health` gets the counts of cells."""

    def __init__(self, site: Site, terrain: SurfaceMap, outlet: Outlet, health: Health) -> None:
        self._site, self._map, self._outlet, self._health = site, terrain, outlet, health

    def info(self) -> None:
        """Where the grid lies in the site's CRS, and what its values mean; latched."""
        geometry = self._site.in_crs(self._map.reference.geometry)
        info = {
            "kinds": {kind.name.lower(): int(kind) for kind in ChangeKind},
            "crs": geometry.crs,
            "x_min": geometry.x_min,
            "y_max": geometry.y_max,
            "resolution": geometry.resolution,
            "width": geometry.width,
            "height": geometry.height,
            "threshold": self._map.config.threshold,
            "canopy_known": self._map.reference.canopy_known,
            "cameras": list(self._map.cameras),
        }
        self._outlet.publish(TERRAIN_INFO, String(data=json.dumps(info)))

    def update(self, changed: Changed) -> None:
        """Cells whose change is new."""
        heights = self._map.heights_at(changed)
        self._outlet.publish(
            TERRAIN_UPDATE, changed_to_msg(changed, heights, self._map.reference.geometry, self._map.newest_ns)
        )

    def grid(self) -> None:
        """All changes in the window that a camera has seen, latched; nothing where none has seen any."""
        window = self._map.seen_window()
        if window is None:
            return
        layers = self._map.layers(window)
        self._outlet.publish(TERRAIN_CHANGE, change_to_msg(layers, self._map.newest_ns))
        self._health.gauge("cells.seen", int((layers.frames > 0).sum()))
        self._health.gauge("cells.judged", int(layers.observed.sum()))
        for kind in ChangeKind:
            if kind is not ChangeKind.NONE:
                self._health.gauge(f"cells.{kind.name.lower()}", int((layers.change == kind).sum()))
