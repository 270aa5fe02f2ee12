from __future__ import annotations

import pytest
from scenes.small_site import SmallSite

from ltm_msgs_py.stamp import stamp_of
from ltm_ros.recordings.replay.offline import Selection
from ltm_ros.recordings.replay.run import _round_ns


@pytest.mark.parametrize("shift", [1, 999_999_999, 1_000_000_000, 86_400_000_000_123])
def test_moved_message_differs_in_its_stamp_alone(small_site: SmallSite, shift: int) -> None:
    selection = Selection.open(small_site.bag, small_site.site)
    pairs = list(zip(selection.decoded(), selection.decoded(shift), strict=True))
    assert len(pairs) == selection.message_count
    for (_, before), (_, after) in pairs:
        assert stamp_of(after) == stamp_of(before) + shift
        after.header.stamp = before.header.stamp
        assert after == before


def test_rounds_of_a_loop_neither_touch_nor_flood(small_site: SmallSite) -> None:
    whole = Selection.open(small_site.bag, small_site.site)
    # 12 frames in 1.35 s: the next round begins after a pause of a twelfth of that.
    assert _round_ns(whole) == pytest.approx(1.35e9 * 12 / 11, rel=1e-3)
    one = Selection.open(small_site.bag, small_site.site, start=0.1, duration=0.001)
    assert one.frame_count == 1
    assert _round_ns(one) == 10**9
