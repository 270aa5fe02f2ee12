"""Convert nanoseconds to builtin_interfaces/Time and back."""

from typing import Any

from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from ltm_core.base.errors import MessageError
from ltm_core.base.number_text import moment_of_stamp

NS_PER_S = 1_000_000_000
LATEST_NS = 2**31 * NS_PER_S - 1
"""The last nanosecond that builtin_interfaces/Time (int32 seconds) can hold: 19 January 2038, 03:14:07 UTC."""


def ns_to_time(stamp_ns: int) -> Time:
    """Return nanoseconds since the epoch as a Time. Raises MessageError if negative or past `LATEST_NS`."""
    stamp_ns = int(stamp_ns)
    if not 0 <= stamp_ns <= LATEST_NS:
        what = f"stamp {stamp_ns} ns does not fit builtin_interfaces/Time (0 to {LATEST_NS} ns)"
        raise MessageError(f"{what}; are these seconds, or another epoch?")
    seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
    return Time(sec=seconds, nanosec=nanoseconds)


def time_to_ns(time: Any) -> int:
    """Return a Time as nanoseconds since the epoch. Raises MessageError if it is negative or not normalised."""
    sec, nanosec = int(time.sec), int(time.nanosec)
    if sec < 0 or not 0 <= nanosec < NS_PER_S:
        raise MessageError(f"stamp sec={sec} nanosec={nanosec}: give sec >= 0 and nanosec in [0, {NS_PER_S})")
    return sec * NS_PER_S + nanosec


def make_header(stamp_ns: int, frame_id: str) -> Header:
    """Return a std_msgs/Header. Raises MessageError as `ns_to_time`."""
    return Header(stamp=ns_to_time(stamp_ns), frame_id=frame_id)


def stamp_of(msg: Any) -> int:
    """Return the `header.stamp` of a stamped message in nanoseconds. Raises MessageError as `time_to_ns`."""
    return time_to_ns(msg.header.stamp)


def time_text(stamp_ns: int) -> str:
    """Return nanoseconds since the epoch as `2023-11-14T22:13:20.100Z (1700000000100000000 ns)`."""
    moment = moment_of_stamp(stamp_ns)
    return f"{moment.strftime('%Y-%m-%dT%H:%M:%S')}.{moment.microsecond // 1000:03d}Z ({stamp_ns} ns)"


def stamp_text(msg: Any) -> str:
    """Return the stamp of a stamped message for errors, as `time_text` writes it; its raw content if it is invalid."""
    try:
        return time_text(stamp_of(msg))
    except MessageError:
        return f"{msg.header.stamp.sec} s {msg.header.stamp.nanosec} ns"
