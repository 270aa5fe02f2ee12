import numpy as np
import pytest

from ltm_core.tracing.holes import filled_at, find_holes, in_outer_hole
from ltm_core.tracing.pyramid import LEAF, MIXED, OUTSIDE, WITHIN, build_pyramid
from ltm_lab.tracers.reference import with_ceilings

pytestmark = pytest.mark.kernel


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
    assert 2 ** (len(pyramid.offsets) - 1) >= max(rows, cols)
    for level in range(LEAF, len(pyramid.offsets)):
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
