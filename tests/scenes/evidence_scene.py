"""A grid of a few fuel cells with a prior, votes for them, and a network whose errors are known."""

import numpy as np

from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.label_errors import LabelCorrelation, LabelErrors, stated_errors
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.prior import FuelPrior
from ltm_core.fuel.rules import FusionRules
from ltm_core.fuel.votes import CellVisibility, CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.vision.labels import Label, LabelSet
from ltm_lab.resources import lab_config

GRID = GridGeometry(15.0, 75.0, 30.0, 3, 2)
LABELS = LabelSet.load()
CODES = np.array([[145, 147, 165], [121, 91, NODATA]], np.int16)
PRIOR = FuelPrior(CODES, GRID)
NOW = 1_700_000_000
HOUR = 3600
YEAR = 365.25 * 86400
INDEPENDENT = LabelCorrelation(cell=0.2, stand=0.02, view=0.02, network=0.01)
ASSUMED = stated_errors(lab_config("assumed_labels.yaml"))
TRUSTED = LabelErrors(ASSUMED.shares, INDEPENDENT)
"""A network whose errors are hardly the same from frame to frame, so that two frames say twice as much as one."""


def votes(
    label: Label | list[int],
    second: float = NOW,
    source: str = "north",
    pixels: int = 40,
    cells: list[tuple[int, int]] | None = None,
    confidence: float | None = None,
    visibility: CellVisibility | None = None,
    grid: GridGeometry = GRID,
) -> CellVotes:
    """`pixels` of one label, or of each label the given number, in some cells; in all by default."""
    cells = list(np.ndindex(grid.shape)) if cells is None else cells
    rows, cols = (np.array(index, np.int32) for index in zip(*cells, strict=True))
    counts = np.zeros((len(cells), len(LABELS)), np.uint32)
    if isinstance(label, Label):
        counts[:, label] = pixels
    else:
        counts[:] = label
    shown = None if confidence is None else np.full(len(cells), confidence, np.float32)
    z = np.zeros(len(cells), np.float32)
    return CellVotes(grid, rows, cols, counts, z, int(second * 10**9), source, shown, visibility)


def fuel_map(
    *frames: CellVotes, prior: FuelPrior | None = PRIOR, errors: LabelErrors = TRUSTED, **rules: float
) -> EvidenceMap:
    result = EvidenceMap(GRID, prior, LABELS, FusionRules(**{"support": 0.0, "block_cells": 1} | rules), errors)
    for frame in frames:
        result.add(frame)
    return result


def visibility(n: int, **columns: float) -> CellVisibility:
    values = {"cos_incidence": 1.0, "footprint": 0.0, "sigma_along": 0.0, "sigma_across": 0.0, "bearing": 0.0} | columns
    return CellVisibility(*(np.full(n, value, np.float32) for value in values.values()))
