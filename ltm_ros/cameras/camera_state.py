"""How a camera is, and since when."""

from __future__ import annotations

from enum import StrEnum


class CameraState(StrEnum):
    CONNECTING = "connecting"
    """Asked for the first time, or again after a trouble that is over."""
    ALIVE = "alive"
    STALLED = "stalled"
    """No picture that can be used comes: it cannot be reached, breaks off, or sends what is none."""
    UNAUTHORISED = "unauthorised"
    """It refuses the user or the password, or none can be read."""
    STUCK = "stuck"
    """It sends the same picture again and again, or a turned PTZ head does not change it."""
    MOVED = "moved"
    """Its PTZ head was moving while the pictures were taken."""
    NIGHT = "night"
    """Nothing is to be seen for the dark, or it sees by infrared."""


class StateRecord:
    """The state now. `since`: seconds of the caller's clock."""

    def __init__(self, now: float) -> None:
        self.state = CameraState.CONNECTING
        self.since = now
        self.why = ""

    def become(self, state: CameraState, now: float, why: str = "") -> bool:
        """Whether that is a change; `why` is of the newest word."""
        changed = state is not self.state
        if changed:
            self.state, self.since = state, now
        self.why = why
        return changed
