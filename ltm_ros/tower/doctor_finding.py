"""What `ltm doctor` finds."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class DoctorState(StrEnum):
    OK = "ok"
    OPTIONAL = "optional"
    """Absent, and only some commands need it."""
    WARNING = "warning"
    """Works, but not well."""
    MISSING = "missing"
    """The system does not work without it."""


@dataclass(frozen=True)
class DoctorFinding:
    area: str
    name: str
    state: DoctorState
    detail: str
    remedy: str = ""
    """Command that mends it."""
