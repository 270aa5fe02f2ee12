"""Replay recordings through the graph: live over DDS, or offline through the same handlers."""

from typing import Final

LONGEST_PAUSE: Final = 10.0
"""Default maximum seconds that a replay waits during a recorded pause: towers may patrol once an hour."""
