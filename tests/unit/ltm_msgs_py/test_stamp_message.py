import pytest
from builtin_interfaces.msg import Time

from ltm_core.base.errors import MessageError
from ltm_msgs_py.stamp import LATEST_NS, ns_to_time, time_to_ns


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
