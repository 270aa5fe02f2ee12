from __future__ import annotations

import pytest
from builtin_interfaces.msg import Time

from ltm_core.base.errors import MessageError
from ltm_msgs_py.stamp import LATEST_NS, make_header, ns_to_time, stamp_of, time_to_ns


@pytest.mark.parametrize("stamp_ns", [0, 1, 999_999_999, 1_000_000_000, 1_700_000_000_123_456_789, LATEST_NS])
def test_every_nanosecond_survives(stamp_ns: int) -> None:
    time = ns_to_time(stamp_ns)
    assert 0 <= time.nanosec < 1_000_000_000
    assert time_to_ns(time) == stamp_ns


def test_seconds_and_nanoseconds_are_split_not_rounded() -> None:
    time = ns_to_time(1_700_000_000_999_999_999)
    assert (time.sec, time.nanosec) == (1_700_000_000, 999_999_999)


@pytest.mark.parametrize("stamp_ns", [-1, LATEST_NS + 1, 2**63])
def test_stamps_that_do_not_fit_are_refused_with_their_value(stamp_ns: int) -> None:
    with pytest.raises(MessageError, match=str(stamp_ns)):
        ns_to_time(stamp_ns)


@pytest.mark.parametrize(("sec", "nanosec"), [(-1, 0), (3, 1_000_000_000), (3, 4_294_967_295)])
def test_times_that_are_none_are_refused(sec: int, nanosec: int) -> None:
    with pytest.raises(MessageError, match=f"sec={sec} nanosec={nanosec}"):
        time_to_ns(Time(sec=sec, nanosec=nanosec))


def test_header_carries_stamp_and_frame() -> None:
    class Stamped:
        header = make_header(5_000_000_007, "east_optical")

    assert Stamped.header.frame_id == "east_optical"
    assert stamp_of(Stamped) == 5_000_000_007
