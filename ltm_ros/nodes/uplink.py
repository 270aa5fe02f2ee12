"""uplink: keep the votes of a site's cameras in an outbox, and send them to their region's map."""

import math
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from pydantic import ValidationError
from rclpy.serialization import serialize_message

from ltm_core.base.errors import ConfigError, MessageError, StoreError
from ltm_core.fuel.vote_columns import MAX_BYTES
from ltm_core.site.site_io import load_site
from ltm_core.uplink.envelope import VotesGrid
from ltm_core.uplink.outbox_io import OutboxFrame
from ltm_msgs_py.json_topics import msg_to_model
from ltm_msgs_py.pointcloud import msg_to_columns
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.region.tower_link import TowerLink
from ltm_ros.runtime.clocks import kernel_clock
from ltm_ros.runtime.handler import Handler, NodeConfig, NodeType, Outlet, Topic
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.retry import LAST_TRIES_S
from ltm_ros.runtime.topics import FUEL_VOTES, LABELS_INFO, of_cameras

OUTBOX_FILE: Final = "outbox.sqlite"
SECTORS: Final = 24
"""Number of viewing directions that thinning distinguishes."""


class UplinkNodeConfig(NodeConfig):
    folder: str = ""
    """Folder of the outbox, relative to the site file."""


class UplinkHandler(Handler[UplinkNodeConfig]):
    """Receives votes and writes them to the outbox shortly after."""

    def __init__(self, config: UplinkNodeConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        site = load_site(config.site)
        if site.region is None:
            raise ConfigError(f"{config.site}: has no section `region`")
        if (folder := config.beside_site(config.folder)) is None:
            raise ConfigError(
                "the outbox of the section `region` needs a disk: start with `ltm run --state FOLDER`, or set "
                "`nodes: {uplink: {folder: ...}}` in the site file"
            )
        self._site = site
        self._models: dict[str, str] = {}
        try:
            grid = VotesGrid.of(site.in_crs(site.fuel_geometry(site.open_dem())), site.origin)
        except ValidationError as error:
            raise ConfigError(
                f"crs {site.crs!r}: a site of a region needs a CRS by code, such as EPSG:32611"
            ) from error

        def age_clock() -> int | None:
            """Return the clock for ages: without synchronisation, no frame counts as too old."""
            return None if kernel_clock().synchronised is False else time.time_ns()

        self._link = TowerLink(site.region, grid, folder / OUTBOX_FILE, health, age_clock)

    @property
    def subscriptions(self) -> Mapping[Topic, Callable[[Any], None]]:
        return of_cameras(self._site, {FUEL_VOTES: self.on_votes, LABELS_INFO: self.on_label_info})

    def start(self) -> None:
        self._link.start()

    def on_votes(self, camera: str, message: Any) -> None:
        content = bytes(serialize_message(message))
        if len(content) > MAX_BYTES:
            raise MessageError(f"votes of {camera} of {len(content)} bytes; the maximum of a region is {MAX_BYTES}")
        model = self._models.get(camera, "")
        self._link.offer(OutboxFrame(camera, stamp_of(message), sector(message), model, content))

    def on_label_info(self, camera: str, message: Any) -> None:
        self._models[camera] = msg_to_model(message)

    def finish(self) -> None:
        """Write the remaining frames. Raises StoreError if that fails; then they are lost."""
        if not self._link.stop():
            raise StoreError(f"frames are lost: the outbox's disk failed, also for {LAST_TRIES_S:.0f} s more")


def sector(message: Any) -> int:
    """Return which of `SECTORS` directions the votes show, by the mean of their bearings; -1 without bearings.

    Raises MessageError if the message is not a table of points."""
    bearings = msg_to_columns(message).get("bearing_deg")
    if bearings is None or not len(bearings):
        return -1
    angles = np.radians(bearings.astype(np.float64))
    mean = math.atan2(float(np.sin(angles).sum()), float(np.cos(angles).sum()))
    return math.floor(mean % (2 * math.pi) * SECTORS / (2 * math.pi)) % SECTORS


NODE = NodeType("uplink", UplinkNodeConfig, UplinkHandler)
run_node(NODE, __name__)
