"""Configure the node `fuel_map`."""

from __future__ import annotations

from pydantic import Field

from ltm_ros.runtime.handler import NodeConfig
from ltm_ros.runtime.stamp_join import MAX_AHEAD_S, MAX_BEHIND_S


class FuelMapConfig(NodeConfig):
    folder: str = ""
    """Folder in which the map is kept between runs and written on request, relative to the site file. Empty: not kept.
    Never set by a message."""
    export_path: str = ""
    """GeoTIFF that the `save` service and a clean stop write; empty: `fuel_map.tif` in `folder`, on request only."""
    accept_unknown_cameras: bool = False
    """Whether to count votes on any `/<site>/<camera>/fuel/votes`, also of cameras that the site file does not name."""
    allow_clear_and_burn: bool = False
    """Whether to serve `fuel_map/clear` and `fuel_map/burn`, with which any node in the graph can delete or burn the
    map's evidence."""
    max_ahead: float = Field(MAX_AHEAD_S, gt=0)
    """Maximum seconds by which a camera's clock may be ahead; frames from the future would make all others old."""
    max_behind: float = Field(MAX_BEHIND_S, gt=0)
    """Maximum seconds by which a frame may be late."""
