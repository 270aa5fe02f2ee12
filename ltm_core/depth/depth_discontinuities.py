"""Where the traced depth of one column leaps: edges between a near surface and what is seen above it."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from ltm_core.types import Float32Array, Int32Array

_BLOCK = 64  # columns that are searched at once in a row with edges


@dataclass(frozen=True, eq=False)
class DepthDiscontinuities:
    """`rows`, `cols`: (N,) int32, the topmost pixels of the near surfaces, from the lowest in the image up, and from
    left to right. `jump`: the ratio of depths from which on there is one."""

    rows: Int32Array
    cols: Int32Array
    jump: float

    @classmethod
    def of(cls, ground: Float32Array, jump: float) -> DepthDiscontinuities:
        """Pixels with ground (H, W) above which the next one is `jump` times as far or more, or sky, or unknown."""
        rows, cols = _edges(ground, np.float32(jump))
        return cls(rows, cols, jump)

    def __len__(self) -> int:
        return len(self.rows)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _edges(ground: Float32Array, jump: np.float32) -> tuple[Int32Array, Int32Array]:
    height = len(ground)
    counts = np.zeros(height, np.int32)
    for v in range(1, height):
        counts[v] = _count(ground[v], ground[v - 1], jump)
    total = counts.sum()
    rows, cols = np.empty(total, np.int32), np.empty(total, np.int32)
    i = 0
    for v in range(height - 1, 0, -1):
        first, end = 0, i + counts[v]
        while i < end:
            here, above = ground[v, first : first + _BLOCK], ground[v - 1, first : first + _BLOCK]
            if _count(here, above, jump):
                for u in range(len(here)):
                    if here[u] < np.float32(1e9) and not above[u] < jump * here[u]:
                        rows[i], cols[i] = v, first + u
                        i += 1
            first += _BLOCK
    return rows, cols


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _count(here: Float32Array, above: Float32Array, jump: np.float32) -> np.int32:
    """How many edges a piece of a row has. Compilers turn this into vector code: most rows have none."""
    count = np.int32(0)
    for u in range(len(here)):
        count += np.int32((here[u] < np.float32(1e9)) & (not above[u] < jump * here[u]))
    return count
