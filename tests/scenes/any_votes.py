"""Any votes that the wire lets through, for what must hold whatever frames come (hypothesis)."""

import numpy as np
from hypothesis import strategies as st

from ltm_core.fuel.evidence import EPOCH_S, EvidenceMap
from ltm_core.fuel.label_errors import LabelErrors, stated_errors
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.prior import FuelPrior
from ltm_core.fuel.votes import CellVisibility, CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.vision.labels import LabelSet
from ltm_lab.resources import lab_config

GRID = GridGeometry(-60.0, 120.0, 30.0, 5, 4)
LABELS = LabelSet.load()
CODES = np.array(
    [[145, 147, 165, 102, 91], [121, 99, NODATA, 183, 145], [101, 101, 145, 145, 204], [98, 7, 145, 186, 165]], np.int16
)
PRIOR = FuelPrior(CODES, GRID)
BEGIN = 1_700_000_000
CELLS = [(row, col) for row in range(4) for col in range(5)]
ASSUMED = stated_errors(lab_config("assumed_labels.yaml"))


@st.composite
def frames(draw: st.DrawFn) -> CellVotes:
    """Any votes that the wire lets through: of any size, sureness and placement, within three epochs and more."""
    cells = sorted(draw(st.sets(st.sampled_from(CELLS), min_size=1, max_size=8)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = len(cells)
    counts = np.zeros((n, len(LABELS)), np.uint32)
    counts[np.arange(n), rng.integers(0, len(LABELS), n)] = rng.choice([1, 3, 40, 100_000, 2**31], n)
    counts[np.arange(n), rng.integers(0, len(LABELS), n)] += rng.choice([0, 2, 500], n).astype(np.uint32)
    visibility = None
    if draw(st.booleans()):
        columns = (
            rng.uniform(0, 1, n),
            rng.choice([0.0, 5.0, 1e9], n),
            rng.choice([0.0, 40.0, 299.0, 1e9], n),
            rng.choice([0.0, 20.0, 299.0], n),
            rng.uniform(-7, 7, n),
        )
        visibility = CellVisibility(*(column.astype(np.float32) for column in columns))
    confidence = rng.uniform(0, 1, n).astype(np.float32) if draw(st.booleans()) else None
    second = BEGIN + draw(st.integers(0, 12)) * draw(st.sampled_from([1, 3600, EPOCH_S]))
    rows, cols = (np.array(index, np.int32) for index in zip(*cells, strict=True))
    z = np.zeros(n, np.float32)
    source = draw(st.sampled_from(["north", "east", "south"]))
    return CellVotes(GRID, rows, cols, counts, z, second * 10**9, source, confidence, visibility)


def counted(*of: CellVotes, network: LabelErrors = ASSUMED, prior: FuelPrior | None = PRIOR) -> EvidenceMap:
    result = EvidenceMap(GRID, prior, LABELS, errors=network)
    for frame in of:
        result.add(frame)
    return result
