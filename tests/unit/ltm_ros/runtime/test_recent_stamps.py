"""RecentStamps: knows the last so many, and no others."""

from __future__ import annotations

from collections import deque

from hypothesis import given
from hypothesis import strategies as st

from ltm_ros.runtime.stamp_join import RecentStamps

STAMPS = st.one_of(st.integers(-3, 9), st.just(0), st.just(2**63 - 1))


@given(st.integers(1, 7), st.lists(STAMPS, max_size=40))
def test_it_knows_the_last_ones_alone(count: int, stamps: list[int]) -> None:
    recent, model = RecentStamps(count), deque[int](maxlen=count)
    for stamp in stamps:
        recent.add(stamp)
        model.append(stamp)
        assert {other: other in recent for other in (*range(-4, 11), 2**63 - 1)} == {
            other: other in model for other in (*range(-4, 11), 2**63 - 1)
        }
