"""State of a block of neighbouring image columns during the column sweep, one row at a time.

A block is one flat float64 array, in which each field has `COLUMNS` places from the index on that stands here.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ltm_core.types import Float64Array

COLUMNS = 64
PER_MAJOR, T, SLOPE, FACE, WEDGE, HINT, NEAR, BEGIN = range(0, 8 * COLUMNS, COLUMNS)
"""1 / |major| of the unit ray; t; slope in metres a major cell; face and wedge; place of the entry of the row below
within its wedge; node line where the ray's entry begins, or one of the following; range from which the pyramid goes on.
"""
MEETS_NOTHING, BY_PYRAMID, ON_FROM_CELL = -1.0, -2.0, -3.0


@njit(cache=True)  # type: ignore[untyped-decorator]
def new_block() -> Float64Array:
    """A block before its first row."""
    return np.zeros(8 * COLUMNS)
