"""Write numbers for people, and convert UTC times."""

import math
from datetime import UTC, datetime, timedelta
from typing import Final

NOTHING = "\N{EN DASH}"


def number(value: float, digits: int = 0, sign: bool = False) -> str:
    """Return `12,180` or `-0.5`: rounded to `digits` decimals, never a negative zero; a dash if it is not finite.

    `sign`: write a plus sign before positive numbers."""
    if not math.isfinite(value):
        return NOTHING
    rounded = round(float(value), digits) + 0.0  # turns -0.0 into 0.0
    return f"{rounded:{'+' if sign and rounded else ''},.{digits}f}"


def difference(before: float, after: float, digits: int = 0) -> str:
    """Return the signed difference of two numbers as they are shown, so that a reader can check it: 446, 323: -123."""
    return number(round(after, digits) - round(before, digits), digits, sign=True)


def percent(share: float, digits: int = 1) -> str:
    """Return a share between 0 and 1 as `23.4 %`."""
    return f"{number(100 * share, digits)} %" if math.isfinite(share) else NOTHING


def counted(count: int, thing: str) -> str:
    """Return `1 camera` or `2,000 cameras`; `thing` is a singular whose plural ends in s."""
    return f"{count:,} {thing}{'' if count == 1 else 's'}"


DAY_NS: Final = 86_400 * 10**9
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def stamp_of_moment(moment: datetime) -> int:
    """Return nanoseconds since 1970, negative before; a time without a zone is UTC."""
    since = (moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)) - _EPOCH
    return since // timedelta(microseconds=1) * 1000


def moment_of_stamp(stamp_ns: int) -> datetime:
    """Return the UTC time, rounded down to microseconds. Raises OverflowError outside the years 1 to 9999."""
    return _EPOCH + timedelta(microseconds=stamp_ns // 1000)
