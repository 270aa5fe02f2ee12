from __future__ import annotations

import numpy as np
import pytest

from ltm_core.tracing.holes import filled_at, find_holes, in_outer_hole
from ltm_core.tracing.pyramid import LEAF, MIXED, OUTSIDE, WITHIN, build_pyramid
from ltm_lab.tracers.reference import with_ceilings

pytestmark = pytest.mark.kernel

NAN = np.float32(np.nan)


RISE, HIGHEST = 35.0, 150.0


def brute_force_bound(filled: np.ndarray, level: int, i: int, j: int) -> float:
    """The bound of block (i, j) of `level`, straight from its definition."""
    size = 2**level
    return float(filled[i * size : (i + 1) * size + 1, j * size : (j + 1) * size + 1].max())


def brute_force_outside(outer: np.ndarray, level: int, i: int, j: int) -> int:
    size = 2**level
    cells = outer[:-1, :-1] | outer[:-1, 1:] | outer[1:, :-1] | outer[1:, 1:]
    block = cells[i * size : (i + 1) * size, j * size : (j + 1) * size]
    return OUTSIDE if block.all() else MIXED if block.any() else WITHIN


@pytest.mark.parametrize("shape", [(2, 2), (2, 9), (5, 3), (17, 33), (38, 71)])
@pytest.mark.parametrize("missing", [0.0, 0.02, 0.6])
def test_every_bound(shape: tuple[int, int], missing: float) -> None:
    rng = np.random.default_rng(shape[0] * 100 + shape[1])
    nodes = rng.normal(0, 100, shape).astype(np.float32)
    nodes[rng.random(shape) < missing] = np.nan
    pyramid = build_pyramid(nodes, find_holes(nodes, RISE, HIGHEST))
    filled, outer = with_ceilings(nodes, RISE, HIGHEST)
    assert (pyramid.outside.size > 0) == outer.any()
    rows, cols = shape[0] - 1, shape[1] - 1
    assert 2**pyramid.top_level >= max(rows, cols)
    for level in range(LEAF, pyramid.top_level + 1):
        height, width = -(-rows // 2**level), -(-cols // 2**level)
        assert pyramid.widths[level] == width
        start = pyramid.offsets[level]
        stored = pyramid.bounds[start : start + height * width].reshape(height, width)
        expected = [[brute_force_bound(filled, level, i, j) for j in range(width)] for i in range(height)]
        np.testing.assert_array_equal(stored, np.array(expected, np.float32))
        if outer.any():
            told = pyramid.outside[start : start + height * width].reshape(height, width)
            expected = [[brute_force_outside(outer, level, i, j) for j in range(width)] for i in range(height)]
            np.testing.assert_array_equal(told, np.array(expected))


def filled_by_runs(nodes: np.ndarray, rise: float = RISE, highest: float = HIGHEST) -> np.ndarray:
    holes = find_holes(nodes, rise, highest)
    assert (np.diff(holes.hole_first) > 0).all()
    return np.array([filled_at(nodes.ravel(), holes, at) for at in range(nodes.size)]).reshape(nodes.shape)


@pytest.mark.parametrize("shape", [(2, 2), (5, 3), (17, 33), (38, 71)])
@pytest.mark.parametrize("missing", [0.0, 0.1, 0.35, 0.6, 0.9])
def test_ceilings_against_labelled_holes(shape: tuple[int, int], missing: float) -> None:
    rng = np.random.default_rng(shape[0] * 7 + shape[1])
    for _ in range(5):
        nodes = rng.normal(0, 100, shape).astype(np.float32)
        nodes[rng.random(shape) < missing] = np.nan
        if np.isfinite(nodes).any():
            filled, outer = with_ceilings(nodes, RISE, HIGHEST)
            np.testing.assert_array_equal(filled_by_runs(nodes), filled)
            holes = find_holes(nodes, RISE, HIGHEST)
            told = [in_outer_hole(nodes.ravel(), holes, at) for at in range(nodes.size)]
            np.testing.assert_array_equal(np.reshape(told, shape), outer)


def test_an_enclosed_hole_is_no_higher_than_its_highest_neighbour() -> None:
    nodes = np.arange(48, dtype=np.float32).reshape(6, 8)
    nodes[2, 3] = nodes[3, 4] = NAN  # touch at a corner: one hole
    filled = filled_by_runs(nodes)
    assert filled[2, 3] == filled[3, 4] == nodes[4, 5]
    known = ~np.isnan(nodes)
    np.testing.assert_array_equal(filled[known], nodes[known])


def test_a_hole_is_no_steeper_than_stated() -> None:
    nodes = np.full((7, 11), 5.0, np.float32)
    nodes[2:5, 2:9] = NAN
    nodes[3, 9] = 100.0  # one spike at its rim
    beside_the_spike = 5 + 2 * np.sqrt(2)  # from the nodes north and south of it
    expected = [5, 5, 7, 9, 9, 9, 9, 9, beside_the_spike, 100, 5]
    np.testing.assert_allclose(filled_by_runs(nodes, rise=2.0)[3], expected, rtol=1e-6)


def test_an_outer_hole_rises_to_the_highest_possible_ground_around_corners() -> None:
    nodes = np.full((5, 9), NAN, np.float32)
    nodes[0, 0] = 10.0
    nodes[:4, 4] = 60.0  # a wall between the two halves
    filled = filled_by_runs(nodes, rise=10.0, highest=65.0)
    assert filled[0, :4].tolist() == [10, 20, 30, 40]
    np.testing.assert_allclose(filled[2:4, 1], [10 + 10 * (1 + np.sqrt(2)), 10 + 10 * (2 + np.sqrt(2))], rtol=1e-6)
    assert filled[4, 4] == filled[4, 8] == 65.0
