"""What a network answers where the true depth is known: its slow errors and its noise, by region and by depth.

The question that fusion asks of every pixel is not how far off the network usually is, but what it would say *here* if
the terrain were right. A network that takes all far hills for nearer ones does not contradict a far hill; one that sees
them so everywhere but at one spot does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from ltm_core.depth.ground_sampling import GroundSamples
from ltm_core.types import Float32Array, Float64Array, IndexArray, Int32Array

OCTAVES = 28
"""Half octaves of depth, from 4 m on."""
FIRST = 4.5
"""2 log2 of the first half octave's middle, metres."""
_FARTHEST = 40_000.0
_STEPS = 4096  # of each of three tables of logarithms
_NEAR, _MIDDLE, _FAR = (
    np.clip(2.0 * np.log2((np.arange(_STEPS) + 0.5) * width) - FIRST, 0.0, OCTAVES - 1.001).astype(np.float32)
    for width in (1 / 16, 1.0, 16.0)
)


class ErrorTables(NamedTuple):
    """An `ErrorModel` as compiled code takes it. `least_said`: of the true inverse depth that a network says."""

    shift: Float32Array
    factor: Float32Array
    least_said: np.float32


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """Where the true inverse depth is x, the network says x - shift x, with a sigma of factor x.

    `tables`: shift and factor, (R, C, D) float32 over the photo and half octaves of depth. `regional`: whether they
    differ over the photo.
    """

    tables: ErrorTables
    regional: bool

    @classmethod
    def none(cls) -> ErrorModel:
        """In place of a network that is not there."""
        plain = np.zeros((1, 1, OCTAVES), np.float32)
        return cls(ErrorTables(plain, plain + 1, np.float32(1.0)), False)

    def standardized(self, read: Float64Array, samples: GroundSamples, size: tuple[int, int]) -> Float64Array:
        """True less read inverse depth at samples (N,), in sigmas of both network and terrain."""
        shift, factor, _ = self.tables
        rows = samples.rows * shift.shape[0] // size[0]
        cols = samples.cols * shift.shape[1] // size[1]
        at = rows, cols, octaves(samples.depth)
        off = 1.0 - read * samples.depth - shift[at]
        return np.asarray(off / np.hypot(factor[at], samples.sigma / samples.depth), np.float64)


def octaves(depth: NDArray[np.floating]) -> IndexArray:
    """The half octave that each depth, metres, is in."""
    places = np.rint(2.0 * np.log2(depth) - FIRST)
    return np.asarray(np.clip(places, 0, OCTAVES - 1), np.intp)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _place(depth: np.float32) -> np.float32:
    """Where a depth, metres, lies among the half octaves: a logarithm, looked up, since every pixel asks."""
    if depth < np.float32(_STEPS / 16):
        return np.float32(_NEAR[int(depth * np.float32(16.0))])
    if depth < np.float32(_STEPS):
        return np.float32(_MIDDLE[int(depth)])
    return np.float32(_FAR[min(int(depth * np.float32(1 / 16)), _STEPS - 1)])


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def expected_prediction(row: int, col: int, inverse: np.float32, tables: ErrorTables) -> tuple[np.float32, np.float32]:
    """By how much less than the true `inverse` depth the network says in a cell of the tables, and its sigma, 1/m."""
    # What has no depth, as the sky, is taken for the farthest that the tables know.
    inverse = max(inverse, np.float32(1 / _FARTHEST))
    shift, factor = tables.shift, tables.factor
    place = _place(np.float32(1.0) / inverse)
    k = int(place)
    part = place - np.float32(k)
    less = shift[row, col, k] + part * (shift[row, col, k + 1] - shift[row, col, k])
    sigma = factor[row, col, k] + part * (factor[row, col, k + 1] - factor[row, col, k])
    return less * inverse, sigma * inverse


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def interpolation_table(tables: ErrorTables) -> Float32Array:
    """Both tables (R, C, D) side by side, (R, C * D, 4): each value, and by how much the next half octave's is more."""
    shift, factor = tables.shift, tables.factor
    rows, cols, count = shift.shape
    both = np.zeros((rows, cols * count, 4), np.float32)
    for i in range(rows):
        for j in range(cols):
            for k in range(count):
                after = min(k + 1, count - 1)
                both[i, j * count + k, 0] = shift[i, j, k]
                both[i, j * count + k, 1] = shift[i, j, after] - shift[i, j, k]
                both[i, j * count + k, 2] = factor[i, j, k]
                both[i, j * count + k, 3] = factor[i, j, after] - factor[i, j, k]
    return both


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract"})  # type: ignore[untyped-decorator]
def expected_predictions(
    inverse: Float32Array,
    tables: Float32Array,
    col: Int32Array,
    place: Int32Array,
    part: Float32Array,
    less: Float32Array,
    sigma: Float32Array,
) -> None:
    """`expected_prediction` for a row of pixels (W,), into `less` and `sigma`. `tables`: (C * D, 4) one row of
    `interpolation_table`; `col`: (W,) of the tables; `place`, `part`: (W,), to work in.

    The logarithm is taken from the numbers' own bits, so that no table is looked up: log2(2^e (1 + m)) is
    e + m + 0.3438 m (1 - m) but for 0.009.
    """
    least, last = np.float32(1 / _FARTHEST), np.float32(OCTAVES - 1.001)
    for u in range(len(inverse)):
        sigma[u] = inverse[u] if inverse[u] > least else least
    bits = sigma.view(np.int32)
    for u in range(len(inverse)):
        m = np.float32(bits[u] & 0x7FFFFF) * np.float32(2.0**-23)
        log2 = np.float32((bits[u] >> 23) - 127) + m + np.float32(0.3438) * m * (np.float32(1.0) - m)
        at = np.float32(-2.0) * log2 - np.float32(FIRST)
        at = at if at > 0 else np.float32(0.0)
        part[u] = at if at < last else last
    for u in range(len(inverse)):
        place[u] = np.int32(part[u]) + col[u] * np.int32(OCTAVES)
    for u in range(len(inverse)):
        part[u] -= np.float32(np.int32(part[u]))
    for u in range(len(inverse)):
        at, x, more = tables[place[u]], sigma[u], part[u]
        less[u] = (at[0] + more * at[1]) * x
        sigma[u] = (at[2] + more * at[3]) * x


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def invert(row: int, col: int, read: np.float32, tables: ErrorTables) -> tuple[np.float32, np.float32]:
    """The true inverse depth that the network means where it says `read`, and its sigma, 1/m."""
    plain = np.float32(1.0)
    less, sigma = expected_prediction(row, col, read, tables)
    if read > 0:
        plain = max(plain - less / read, tables.least_said)
    return read / plain, sigma / plain
