"""Convert between calendar times and nanoseconds since 1970, exactly in integers."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Final

DAY_NS: Final = 86_400 * 10**9
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def stamp_of_moment(moment: datetime) -> int:
    """Return nanoseconds since 1970, negative before; a time without a zone is UTC."""
    since = (moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)) - _EPOCH
    return since // timedelta(microseconds=1) * 1000


def moment_of_stamp(stamp_ns: int) -> datetime:
    """Return the UTC time, rounded down to microseconds. Raises OverflowError outside the years 1 to 9999."""
    return _EPOCH + timedelta(microseconds=stamp_ns // 1000)
