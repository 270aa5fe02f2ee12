"""Define the states of a camera, and keep them from flapping."""

from __future__ import annotations

from enum import StrEnum


class CameraState(StrEnum):
    CONNECTING = "connecting"
    """Before the first image."""
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

    @property
    def failing(self) -> bool:
        """Return whether the camera needs a repair."""
        return self in (CameraState.STALLED, CameraState.UNAUTHORISED, CameraState.STUCK)

    @property
    def sending(self) -> bool:
        return self in (CameraState.ALIVE, CameraState.NIGHT, CameraState.MOVED)


class StateRecord:
    """The current state, from what each request showed. A single failure does not change it: a state ends when it has
    not been seen for `hold_s` seconds. Rejected passwords count at once, and so does the first good image afterwards.

    Args: now, hold_s: seconds of the caller's clock.
    """

    def __init__(self, now: float, hold_s: float) -> None:
        self.state = self.latest = CameraState.CONNECTING
        """The camera's state, and what the latest request showed."""
        self.since = self._seen = now
        self._hold_s = hold_s
        self.why = ""
        """Reason of the latest failure; empty: the latest request succeeded."""

    def saw(self, state: CameraState, now: float, why: str = "") -> bool:
        """Take what a request showed; return whether the camera's state changed."""
        self.latest, self.why = state, why
        recovered = self.state.failing and state in (CameraState.ALIVE, CameraState.NIGHT)
        at_once = self.state is CameraState.CONNECTING or state is CameraState.UNAUTHORISED or recovered
        if state is self.state:
            self._seen = now
        elif at_once or now - self._seen >= self._hold_s:
            self.state, self.since, self._seen = state, now, now
            return True
        return False
