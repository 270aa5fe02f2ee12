"""Define the states of a camera."""

from __future__ import annotations

from enum import StrEnum


class CameraState(StrEnum):
    CONNECTING = "connecting"
    """First request, or a new request after a solved problem."""
    ALIVE = "alive"
    STALLED = "stalled"
    """No usable image: not reachable, connection lost, or invalid data."""
    UNAUTHORISED = "unauthorised"
    """The camera rejected the user or password, or the password cannot be read."""
    STUCK = "stuck"
    """The camera repeats the same image, or the image does not change with the PTZ head."""
    MOVED = "moved"
    """The PTZ head moved during the exposures."""
    NIGHT = "night"
    """The image is dark, or infrared."""


class StateRecord:
    """The current state. `since`: seconds of the caller's clock."""

    def __init__(self, now: float) -> None:
        self.state = CameraState.CONNECTING
        self.since = now
        self.why = ""

    def become(self, state: CameraState, now: float, why: str = "") -> bool:
        """Set the state and its latest reason; return whether the state changed."""
        changed = state is not self.state
        if changed:
            self.state, self.since = state, now
        self.why = why
        return changed
