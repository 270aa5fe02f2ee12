import pytest
from scenes.small_site import SmallSite

from ltm_msgs_py.stamp import stamp_of
from ltm_ros.recordings.replay.offline import Selection


@pytest.mark.parametrize("shift", [1, 999_999_999, 1_000_000_000, 86_400_000_000_123])
def test_moved_message_differs_in_its_stamp_alone(small_site: SmallSite, shift: int) -> None:
    selection = Selection.open(small_site.bag, small_site.site)
    pairs = list(zip(selection.decoded(), selection.decoded(shift), strict=True))
    assert len(pairs) == selection.message_count
    for (_, before), (_, after) in pairs:
        assert stamp_of(after) == stamp_of(before) + shift
        after.header.stamp = before.header.stamp
        assert after == before
