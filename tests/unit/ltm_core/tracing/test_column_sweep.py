"""Eight values at a time: each operation against NumPy's, on any processor; and which kernel a tracer takes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from scenes.rasters import rough_terrain

from ltm_core.tracing import TerrainTracer, lanes
from ltm_core.tracing.lanes import (
    any_of,
    compressed,
    count_of,
    floor_of,
    gather,
    gather_pair,
    is_set,
    lane_numbers,
    load,
    load_triples,
    root_of,
    select,
    size_of,
    store,
    to_floats,
    to_ints,
)


@njit(error_model="numpy")
def _operations(a: Any, b: Any, triples: Any, single: Any, index: Any, out: Any) -> Any:
    x, y, i = load(a, 0), load(b, 0), to_ints(load(index, 0))
    less = x < y
    store(out, 0, select(less, x * 2.0 + 1.0, -y / 3.0))
    store(out, 8, root_of(size_of(x)) + floor_of(y))
    p, q = gather_pair(single, i, ~less)
    store(out, 16, p)
    store(out, 24, q)
    store(out, 32, gather(single, i + 1, less | (x == x)))
    store(out, 40, compressed(x, less))
    u, v, w = load_triples(triples, 3)
    store(out, 48, u - v * w)
    store(out, 56, to_floats(lane_numbers() * 2 + to_ints(x)))
    store(out, 64, select(is_set(less, 3), 1.0, 2.0) + (x - x))
    return count_of(less), any_of(x != x), any_of((x > y) & (x <= y))


@njit(error_model="numpy")
def _single(values: Any, out: Any) -> None:
    store(out, 0, load(values, 0) * 3.0)


def test_operations() -> None:
    rng = np.random.default_rng(0)
    a, triples = rng.normal(0, 3, 8), rng.normal(0, 1, 27)
    b = a + np.array([1.0, -2.0, 0.0, 3.0, -0.5, -1.0, 2.0, -4.0])
    single, index = rng.normal(0, 1, 40).astype(np.float32), rng.integers(0, 38, 8).astype(np.float64)
    out = np.empty(72)
    counted, any_nan, any_both = _operations(a, b, triples, single, index, out)
    less, at = a < b, index.astype(int)
    assert 0 < less.sum() < 8
    np.testing.assert_allclose(out[0:8], np.where(less, a * 2 + 1, -b / 3), rtol=1e-15)
    np.testing.assert_allclose(out[8:16], np.sqrt(np.abs(a)) + np.floor(b), rtol=1e-15)
    np.testing.assert_array_equal(out[16:24], np.where(less, 0.0, single[at]))
    np.testing.assert_array_equal(out[24:32], np.where(less, 0.0, single[at + 1]))
    np.testing.assert_array_equal(out[32:40], single[at + 1])
    np.testing.assert_array_equal(out[40 : 40 + less.sum()], a[less])
    u, v, w = triples[3:].reshape(8, 3).T
    np.testing.assert_allclose(out[48:56], u - v * w, rtol=1e-14, atol=1e-15)
    np.testing.assert_array_equal(out[56:64], np.arange(8) * 2 + a.astype(int))
    np.testing.assert_array_equal(out[64:72], np.full(8, 1.0 if less[3] else 2.0))
    assert (counted, any_nan, any_both) == (less.sum(), False, False)
    a[5] = np.nan
    assert _operations(a, b, triples, single, index, out)[1]


def test_lanes_of_single_precision() -> None:
    values, out = np.linspace(-1, 4, 8).astype(np.float32), np.empty(8, np.float32)
    _single(values, out)
    np.testing.assert_allclose(out, values * 3, rtol=1e-6)


def test_the_processor_chooses_unless_told() -> None:
    dem = rough_terrain(3)
    assert TerrainTracer(dem).by_lanes is lanes.fast_here()
    assert TerrainTracer(dem, by_lanes=True).by_lanes
    assert not TerrainTracer(dem, by_lanes=False).by_lanes
