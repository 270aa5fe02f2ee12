"""What no single view and nothing that moves can do to a cell, whatever it shows and however often it comes."""

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes.called import called

from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.tile_store import TileStore
from ltm_core.surface.cell_layout import FIELDS
from ltm_core.surface.cell_update import Rules, independent, mean_variance, update_cell
from ltm_core.surface.tile_pool import TilePool, schema_of

RULES = Rules(3.0, 0.09, 3600.0, 600.0, 8.0, 3.2e7, 1.5, 0.25, 2.5, 0.5)
BEGIN = 1_700_000_000
SLOT, EXACT = np.int32(0), np.float32(0.0)
"""The cell's tile and a pose without error, of the types that the map gives: others would be compiled anew."""
Look = tuple[int, int, float, float, bool]
"""Seconds, bit of the camera, height above the reference, variance, whether it is a bound only."""

heights = st.floats(-50.0, 60.0, width=32)
variances = st.floats(np.float32(0.01).item(), 30.0, width=32)


@cache
def pool(canopy_known: bool) -> TilePool:
    return TilePool(TileStore.in_memory(schema_of(GridGeometry(0.0, 64.0, 1.0, 64, 64))), 1, canopy_known)


def seen_by(looks: Sequence[Look], canopy_known: bool = True) -> TilePool:
    """A fresh cell, the first of the first tile, after these looks."""
    one = pool(canopy_known)
    for name in FIELDS:
        one.cells.records[name][0, 0] = (0.0 if canopy_known else np.nan) if name == "base" else 0
    for seconds, bit, dz, variance, bounded in looks:
        own = float(np.float32(variance))
        called(update_cell)(
            one.cells, SLOT, 0, dz, own, own, EXACT, bounded, seconds, bit, RULES.independent_after, RULES
        )
    return one


def believed(one: TilePool) -> bool:
    """Whether independent views stand behind the cell's estimate."""
    c = one.cells.records[0, 0]
    return bool(c["looks"] > 0) and bool(
        called(independent)(c["cameras"], c["first"], c["last"], RULES.independent_after, RULES.settle)
    )


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 3599), st.just(4), heights, variances, st.booleans()), max_size=12), st.booleans()
)
def test_one_view_is_never_believed(looks: list[Look], canopy_known: bool) -> None:
    looks = [(BEGIN + seconds, *rest) for seconds, *rest in looks]  # type: ignore[misc]
    assert not believed(seen_by(looks, canopy_known))


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 599), st.sampled_from([1, 2, 8]), heights, variances, st.booleans()), max_size=12)
)
def test_cameras_that_look_at_once_are_not_believed(looks: list[Look]) -> None:
    """What they see may have moved on before the settling time is over."""
    assert not believed(seen_by([(BEGIN + seconds, *rest) for seconds, *rest in looks]))  # type: ignore[misc]


@settings(max_examples=200, deadline=None)
@given(st.lists(st.integers(-9, 11).filter(bool), min_size=1, max_size=10, unique=True), st.data())
def test_what_is_elsewhere_each_time_never_becomes_the_estimate(levels: list[int], data: st.DataObject) -> None:
    """Heights 5 m apart, each seen once, by any camera at any hour, among looks at the ground as it is."""
    looks: list[Look] = []
    for i, level in enumerate(levels):
        bit = data.draw(st.sampled_from([1, 2, 4]))
        seconds = BEGIN + 3600 * data.draw(st.integers(0, 50)) + i
        looks.append((seconds, bit, 5.0 * level, 0.05, False))
        if data.draw(st.booleans()):
            looks.append((seconds + 7200, data.draw(st.sampled_from([1, 2, 4])), 0.0, 0.05, False))
    one = seen_by(looks)
    assert abs(float(one.cells.records[0, 0]["dz"])) < 1e-6
    assert one.cells.records[0, 0]["looks"] <= sum(1 for look in looks if look[2] == 0.0)


@settings(max_examples=100, deadline=None)
@given(heights.filter(lambda h: abs(h) > 3.0), st.integers(1, 60), st.integers(1, 60))
def test_what_stays_is_believed(height: float, first: int, second: int) -> None:
    """The same height three times, hours apart, from two cameras."""
    times = (0, 3600 * first, 3600 * (first + second))
    one = seen_by([(BEGIN + t, bit, height, 0.05, False) for t, bit in zip(times, (1, 2, 1), strict=True)])
    assert believed(one)
    assert abs(float(one.cells.records[0, 0]["dz"]) - height) < 1e-3


@settings(max_examples=40, deadline=None)
@given(st.floats(np.float32(0.1).item(), 3.0, width=32), st.integers(1, 40))
def test_looks_of_years_ago_lose_weight_by_the_time_that_passed(rise: float, quarters: int) -> None:
    """Exactly so: the mean of two looks weighs the older by exp(-age / lasting)."""
    begin, age = 1_000_000_000, quarters * 8_000_000
    one = seen_by([(begin, 1, 0.0, 4.0, False), (begin + age, 1, rise, 4.0, False)])
    kept = math.exp(-age / RULES.lasting)
    assert one.cells.records[0, 0]["dz"] == pytest.approx(rise / (1 + kept), rel=1e-4)
    assert one.cells.records[0, 0]["looks"] == pytest.approx(1 + kept, rel=1e-5)


@settings(max_examples=200, deadline=None)
@given(st.floats(1.0, 8.0), st.floats(0.01, 30.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.integers(1, 2**32 - 1))
def test_what_a_camera_repeats_falls_with_cameras_only(
    looks: float, variance: float, part: float, repeats: float, cameras: int
) -> None:
    """Of one look's variance, the pose's part and what repeats of the rest are each camera's own, the rest is new in
    each look: independent sums."""
    pose = part * variance
    common = pose + repeats * (variance - pose)
    expected = common / cameras.bit_count() + (variance - common) / looks
    assert called(mean_variance)(looks, looks / variance, pose, cameras, repeats) == pytest.approx(expected, rel=1e-6)


def passed_below(relative_variance: float) -> TilePool:
    """A cell 8 m below whose surface the rays of two cameras have passed, four times; `relative_variance`: of that."""
    one = pool(True)
    for name in FIELDS:
        one.cells.records[name][0, 0] = 0
    for number in range(4):
        when, camera, after = BEGIN + 3600 * number, 1 + number % 2, RULES.independent_after
        called(update_cell)(one.cells, SLOT, 0, -8.0, 0.25, relative_variance, EXACT, True, when, camera, after, RULES)
    return one


def test_something_is_gone_no_surer_than_the_ray_has_passed() -> None:
    """Two cameras whose rays passed 8 m below the crowns, by 4 sigmas of range: how low the cell is, is known, and that
    its stand has gone is known by 4 sigmas, less what two cameras and their looks make of them."""
    one = passed_below(relative_variance=4.0)
    c = one.cells.records[0, 0]
    assert believed(one)
    assert c["dz"] == pytest.approx(-8.0)
    assert c["looks"] / c["weight"] == pytest.approx(0.25)
    assert c["relative_variance"] == pytest.approx(4.0)


def test_a_ray_that_may_not_have_passed_contradicts_nothing() -> None:
    one = passed_below(relative_variance=(8.0 / 2.9) ** 2)
    assert not believed(one)
    assert one.cells.records[0, 0]["c_looks"] == 0
