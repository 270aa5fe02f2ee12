"""Replays recordings through the graph: live over DDS, or offline through the same handlers."""

from typing import Final

LONGEST_PAUSE: Final = 10.0
"""Seconds that a replay waits where nothing was recorded, unless told otherwise: towers may take a round an hour."""
