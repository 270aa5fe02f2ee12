"""The maximum pyramid and the ceilings of holes against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from ltm_core.tracing.baselines.reference import with_ceilings
from ltm_core.tracing.holes import filled_at, find_holes
from ltm_core.tracing.pyramid import LEAF, build_pyramid

pytestmark = pytest.mark.kernel

NAN = np.float32(np.nan)


def brute_force_bound(nodes: np.ndarray, level: int, i: int, j: int) -> float:
    """The bound of block (i, j) of `level`, straight from its definition."""
    size = 2**level
    block = nodes[i * size : (i + 1) * size + 1, j * size : (j + 1) * size + 1]
    cell_outer = np.isnan(block[:-1, :-1] + block[:-1, 1:] + block[1:, :-1] + block[1:, 1:])
    if cell_outer.all():
        return np.nan
    return np.inf if cell_outer.any() else float(block.max())


@pytest.mark.parametrize("shape", [(2, 2), (2, 9), (5, 3), (17, 33), (38, 71)])
@pytest.mark.parametrize("missing", [0.0, 0.02, 0.6])
def test_every_bound(shape: tuple[int, int], missing: float) -> None:
    rng = np.random.default_rng(shape[0] * 100 + shape[1])
    nodes = rng.normal(0, 100, shape).astype(np.float32)
    nodes[rng.random(shape) < missing] = np.nan
    pyramid = build_pyramid(nodes, find_holes(nodes))
    filled = with_ceilings(nodes)
    rows, cols = shape[0] - 1, shape[1] - 1
    assert 2**pyramid.top_level >= max(rows, cols)
    for level in range(LEAF, pyramid.top_level + 1):
        height, width = -(-rows // 2**level), -(-cols // 2**level)
        assert pyramid.widths[level] == width
        start = pyramid.offsets[level]
        stored = pyramid.bounds[start : start + height * width].reshape(height, width)
        expected = [[brute_force_bound(filled, level, i, j) for j in range(width)] for i in range(height)]
        np.testing.assert_array_equal(stored, np.array(expected, np.float32))


def test_the_pyramid_costs_a_twelfth_of_the_elevations() -> None:
    nodes = np.zeros((512, 1024), np.float32)
    assert build_pyramid(nodes, find_holes(nodes)).bounds.nbytes < 0.085 * nodes.nbytes


def filled_by_runs(nodes: np.ndarray) -> np.ndarray:
    holes = find_holes(nodes)
    assert (np.diff(holes.hole_first) > 0).all()
    return np.array([filled_at(nodes.ravel(), holes, at) for at in range(nodes.size)]).reshape(nodes.shape)


@pytest.mark.parametrize("shape", [(2, 2), (5, 3), (17, 33), (38, 71)])
@pytest.mark.parametrize("missing", [0.0, 0.1, 0.35, 0.6, 0.9])
def test_ceilings_against_labelled_holes(shape: tuple[int, int], missing: float) -> None:
    rng = np.random.default_rng(shape[0] * 7 + shape[1])
    for _ in range(20):
        nodes = rng.normal(0, 100, shape).astype(np.float32)
        nodes[rng.random(shape) < missing] = np.nan
        if np.isfinite(nodes).any():
            np.testing.assert_array_equal(filled_by_runs(nodes), with_ceilings(nodes))


def test_an_enclosed_hole_takes_its_highest_neighbour() -> None:
    nodes = np.arange(48, dtype=np.float32).reshape(6, 8)
    nodes[2, 3] = nodes[3, 4] = NAN  # touch at a corner: one hole
    filled = filled_by_runs(nodes)
    assert filled[2, 3] == filled[3, 4] == nodes[4, 5]
    known = ~np.isnan(nodes)
    np.testing.assert_array_equal(filled[known], nodes[known])


def test_holes_are_told_apart() -> None:
    nodes = np.full((9, 12), 5.0, np.float32)
    nodes[2, 2] = nodes[6, 8] = NAN
    nodes[1, 1], nodes[7, 9] = 20.0, 30.0
    nodes[0, 5] = nodes[1, 6] = nodes[2, 6] = NAN  # reaches the northern edge
    filled = filled_by_runs(nodes)
    assert filled[2, 2] == 20.0
    assert filled[6, 8] == 30.0
    assert np.isnan(filled[[0, 1, 2], [5, 6, 6]]).all()


def test_what_holes_cost() -> None:
    nodes = np.zeros((600, 800), np.float32)
    nodes[100:300, 200:500] = NAN
    assert sum(a.nbytes for a in find_holes(nodes)) == 200 * (8 + 8 + 4)
