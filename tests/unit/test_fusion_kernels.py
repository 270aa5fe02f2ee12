"""The kernels of fusion against plain statements of what they compute."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from ltm_core.depth.answers import OCTAVES, Answers, pairs, said, said_at
from ltm_core.depth.beyond import clear_beyond
from ltm_core.depth.classes import DepthClasses
from ltm_core.depth.combine import _alone, _either, _least, _standing
from ltm_core.depth.edges import Edges
from ltm_core.depth.guided import guided_coefficients
from ltm_core.depth.network_fit import NetworkFit
from ltm_core.depth.seen import SeenDepth, see, see_row
from ltm_core.depth.surface import JUMP
from ltm_core.vision.labels import Label, LabelSet


def beyond_by_components(ground: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(H, W) of unknown regions that touch sky or the image's edge, by OpenCV's components."""
    unknown = np.isnan(ground)
    _, regions = cv2.connectedComponents(unknown.astype(np.uint8), connectivity=8)
    edge = cv2.dilate(np.isposinf(ground).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.bool_)
    edge[[0, -1]] = edge[:, [0, -1]] = True
    return unknown & np.isin(regions, np.unique(regions[edge & unknown]))


@pytest.mark.parametrize("share", [0.02, 0.3, 0.45, 0.7, 1.0])
def test_land_beyond_is_what_components_say(share: float) -> None:
    rng = np.random.default_rng(int(share * 100))
    for _ in range(10):
        ground = rng.uniform(10, 900, (37, 53)).astype(np.float32)
        ground[rng.random(ground.shape) < share] = np.nan
        ground[rng.random(ground.shape) < 0.01] = np.inf
        depth, sigma, source = np.ones_like(ground), np.ones_like(ground), np.ones(ground.shape, np.uint8)
        clear_beyond(ground, depth, sigma, source)
        expected = beyond_by_components(ground)
        np.testing.assert_array_equal(np.isnan(depth), expected)
        np.testing.assert_array_equal(np.isnan(sigma), expected)
        np.testing.assert_array_equal(source == 0, expected)


def test_a_row_of_pixels_is_told_what_each_would_be() -> None:
    rng = np.random.default_rng(3)
    shift = rng.normal(0, 0.1, (2, 5, OCTAVES)).astype(np.float32).cumsum(axis=2)
    factor = rng.uniform(0.05, 0.2, (2, 5, OCTAVES)).astype(np.float32).cumsum(axis=2)
    depth = np.exp(rng.uniform(np.log(3.0), np.log(60_000.0), 400)).astype(np.float32)
    inverse = np.concatenate([1 / depth, [0.0]]).astype(np.float32)
    col = rng.integers(0, 5, len(inverse)).astype(np.int32)
    less, sigma, part = (np.empty_like(inverse) for _ in range(3))
    said_at(inverse, pairs(shift, factor)[1], col, np.empty(len(inverse), np.int32), part, less, sigma)
    for u in range(len(inverse)):
        one = said(1, int(col[u]), inverse[u], shift, factor)
        # Both logarithms are near ones: a fiftieth of a half octave.
        assert less[u] == pytest.approx(one[0], abs=0.02 * float(inverse[u]) + 1e-7)
        assert sigma[u] == pytest.approx(one[1], rel=0.03)


@pytest.mark.parametrize("size", [(36, 64), (17, 29), (150, 260)])
def test_a_network_is_enlarged_as_opencv_enlarges(size: tuple[int, int]) -> None:
    """Smaller and larger than the photo, with a hole."""
    rng = np.random.default_rng(size[0])
    rgb = rng.integers(0, 255, (120, 200, 3)).astype(np.uint8)
    inverse = np.exp(cv2.GaussianBlur(rng.normal(-5, 3, size), (0, 0), 3.0)).astype(np.float32)
    near, back = inverse * np.float32(1.2), inverse * np.float32(0.8)
    inverse[3:6, 4:9] = np.nan
    seen = SeenDepth.of(NetworkFit(inverse, near, back, Answers.none(), 0.01, None, ""), rgb)
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    gain, offset, near, back = (
        cv2.resize(a, (200, 120), interpolation=cv2.INTER_LINEAR)
        for a in (*guided_coefficients(inverse, grey), near, back)
    )
    expected = offset + gain * grey
    expected = np.where(expected > near, near, expected)
    expected = np.where(expected < back, back, expected)
    row, out = np.empty((4, size[1]), np.float32), np.empty((3, 200), np.float32)
    found = np.empty((120, 200), np.float32)
    for v in range(120):
        see_row(seen.cells, seen.grey, seen.columns, seen.parts, v, row, out)
        found[v] = out[0]
        np.testing.assert_allclose(out[1], near[v], rtol=1e-4)
        np.testing.assert_allclose(out[2], back[v], rtol=1e-4)
    known = ~np.isnan(expected)
    assert 0.5 < known.mean() < 1.0
    # A pixel whose weight of a neighbour is 0 may still see that it is none.
    assert (np.isnan(found) == np.isnan(expected)).mean() > 0.98
    both = known & ~np.isnan(found)
    np.testing.assert_allclose(found[both], expected[both], rtol=2e-3)
    for v, u in ((0, 0), (119, 199), (57, 101), (20, 150)):
        one = see(seen.cells, seen.grey, seen.columns, seen.parts, v, u)
        assert one == pytest.approx(found[v, u], rel=1e-5, nan_ok=True)


@pytest.mark.parametrize("share", [0.0, 0.03, 0.6])
def test_edges_are_where_depth_leaps_from_below_to_above(share: float) -> None:
    rng = np.random.default_rng(6)
    ground = np.full((41, 203), 100.0, np.float32)
    other = rng.random(ground.shape) < share
    ground[other] = rng.choice([50.0, 120.0, 126.0, 900.0, np.inf, np.nan], int(other.sum()))
    edges = Edges.of(ground)
    leaps = np.isfinite(ground[1:]) & ~(ground[:-1] < np.float32(JUMP) * ground[1:])
    rows, cols = np.nonzero(leaps[::-1])
    np.testing.assert_array_equal(edges.rows, len(leaps) - rows)
    np.testing.assert_array_equal(edges.cols, cols)
    assert (len(edges) > 0) == (share > 0)


def test_the_nearer_a_thing_the_likelier_it_stands_before_the_ground() -> None:
    standing = DepthClasses.of(LabelSet.load()).standing
    far, none = np.float32(1 / 900), np.float32(0.0)
    for odds in standing[[int(Label.GRASS), int(Label.SHRUB), int(Label.TREE), 255]]:
        chances = [_standing(np.float32(1 / near), far, none, odds) for near in (890, 600, 300, 100, 40, 20)]
        assert np.all(np.diff(chances[:-1]) > 0)
        assert chances[-1] == pytest.approx(chances[-2], rel=1e-6)  # beyond twenty times nearer it grows no more
        assert 0 < chances[0] < chances[-1] < 1
        assert _standing(np.float32(1 / 300), far, np.float32(1.0), odds) < chances[2]
    assert _standing(np.float32(1 / 40), far, none, standing[int(Label.SKY)]) == 0


def test_what_is_passed_over_would_not_have_been_taken() -> None:
    """`_least` is a short cut: of a disagreement below it nothing is taken for a thing before the ground, however far
    behind that lies."""
    rng = np.random.default_rng(1)
    spread, gross = np.float32(1e-3), np.float32(1e-6)
    for odds in DepthClasses.of(LabelSet.load()).standing[1:7]:
        least = _least(_standing(np.float32(1.0), np.float32(0.0), np.float32(0.0), odds))
        for _ in range(40):
            joint = np.float32(spread**2 * rng.uniform(1.0, 4.0))
            off = np.float32(np.sqrt(0.98 * max(least, 0.0) * joint))
            y = np.float32(off + 1e-4)
            chance = _standing(y, np.float32(1e-4), np.float32(0.0), odds)
            assert _alone(y, y, y, off, joint, spread, gross, np.float32(chance))[0] == 0


@pytest.mark.parametrize("likely", [0.25, 0.5, 0.7])
def test_a_depth_that_may_be_either_of_two_has_their_mean_and_all_of_their_spread(likely: float) -> None:
    """As many draws from both say."""
    rng = np.random.default_rng(4)
    draws = np.where(rng.random(400_000) < likely, rng.normal(90, 9, 400_000), rng.normal(700, 30, 400_000))
    mean, sigma = _either(*np.array([700, 30, 90, 9, likely], np.float32))
    assert mean == pytest.approx(draws.mean(), rel=0.01)
    assert sigma == pytest.approx(draws.std(), rel=0.01)
