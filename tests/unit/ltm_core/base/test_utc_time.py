from datetime import UTC, datetime, timedelta, timezone

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ltm_core.base.number_text import moment_of_stamp, stamp_of_moment


@pytest.mark.parametrize(
    ("moment", "expected"),
    [
        (datetime(1970, 1, 2, 0, 0, 1, 5, tzinfo=UTC), 86_401_000_005_000),
        (datetime(2026, 11, 23, 20, 2, 3, 250_000), 1_795_464_123_250_000_000),  # no zone: UTC
        (datetime(2026, 11, 23, 22, 2, 3, 250_000, timezone(timedelta(hours=2))), 1_795_464_123_250_000_000),
        (datetime(1969, 12, 31, 23, 59, 59, 999_999, tzinfo=UTC), -1000),
    ],
)
def test_nanoseconds_of_a_moment(moment: datetime, expected: int) -> None:
    assert stamp_of_moment(moment) == expected
    again = moment_of_stamp(expected)
    assert again == (moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC))
    assert again.utcoffset() == timedelta(0)


@given(st.integers(0, 2**62))
def test_to_the_microsecond_below(stamp_ns: int) -> None:
    assert stamp_of_moment(moment_of_stamp(stamp_ns)) == stamp_ns - stamp_ns % 1000


def test_what_no_calendar_has() -> None:
    with pytest.raises(OverflowError):
        moment_of_stamp(2**63 * 1000)
