"""Convert states and counts to diagnostic_msgs and back: `/diagnostics`, and what is stated of a frame or a surface."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ltm_core.base.errors import MessageError
from ltm_msgs_py.stamp import make_header

MOST_VALUES = 100
LONGEST = 4096
"""Maximum number of values in a message, and of characters in each."""


def status_message(
    name: str, level: bytes, message: str, values: Mapping[str, object], hardware_id: str = ""
) -> DiagnosticStatus:
    """Return a status. Nested mappings become keys with dots; None is empty, a list is separated by spaces."""
    pairs = [KeyValue(key=key, value=value) for key, value in _flat(values)]
    return DiagnosticStatus(level=level, name=name, hardware_id=hardware_id, message=message, values=pairs)


def _flat(values: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", _text(value)


def _text(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple | np.ndarray):
        return " ".join(map(_text, value))
    return "" if value is None else repr(float(value)) if isinstance(value, float) else str(value)


def status_to_msg(
    name: str, stamp_ns: int, values: Mapping[str, object], message: str = "", wrong: bool = False
) -> DiagnosticArray:
    """Return one status with the stamp of what it is about. `name`: topic and camera; `wrong`: level WARN."""
    level = DiagnosticStatus.WARN if wrong else DiagnosticStatus.OK
    return DiagnosticArray(
        header=make_header(stamp_ns, ""), status=[status_message(name, level, message[:LONGEST], values)]
    )


def msg_to_values(msg: Any) -> dict[str, str]:
    """Return the values of a message with one status. Raises MessageError for more, or for longer ones."""
    if len(msg.status) != 1 or len(msg.status[0].values) > MOST_VALUES:
        raise MessageError(f"expected one status with at most {MOST_VALUES} values, got {len(msg.status)} statuses")
    values = {pair.key: pair.value for pair in msg.status[0].values}
    if any(len(text) > LONGEST for pair in values.items() for text in pair):
        raise MessageError(f"a status has a text of more than {LONGEST} characters")
    return values
