"""Configure the node `fuel_map`, and compile the kernels that it needs."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.votes import CellVisibility, CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.site.networks import camera_label_errors, site_label_errors
from ltm_core.site.site import Site
from ltm_core.vision.labels import LabelSet
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


def compile_kernels(site: Site, labels: LabelSet) -> None:
    """Compile the kernels, including those for a network's two-scale inference."""
    one = np.ones(1, np.float32)
    cell, counts = np.zeros(1, np.int32), np.ones((1, len(labels)), np.uint32)
    tiny = GridGeometry(0.0, 60.0, 30.0, 3, 2)
    votes = CellVotes(tiny, cell, cell, counts, one, 0, "", one, CellVisibility(*([100 * one] * 5)))
    for errors in (site_label_errors(site), *camera_label_errors(site).values()):
        EvidenceMap(tiny, None, labels, errors=errors).add(votes)
