"""Compiles, or loads from the cache, what a fuel map needs to count a frame: before the first one waits for it."""

from __future__ import annotations

import numpy as np

from ltm_core.fuel.cell_visibility import CellVisibility
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.site.networks import camera_label_errors, site_label_errors
from ltm_core.site.site import Site
from ltm_core.vision.labels import LabelSet


def compile_kernels(site: Site, labels: LabelSet) -> None:
    """Also those that only the looks of a network's cells need."""
    one = np.ones(1, np.float32)
    cell, counts = np.zeros(1, np.int32), np.ones((1, len(labels)), np.uint32)
    tiny = GridGeometry(0.0, 60.0, 30.0, 3, 2)
    votes = CellVotes(tiny, cell, cell, counts, one, 0, "", one, CellVisibility(*([100 * one] * 5)))
    for errors in (site_label_errors(site), *camera_label_errors(site).values()):
        EvidenceMap(tiny, None, labels, errors=errors).add(votes)
