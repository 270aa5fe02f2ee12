"""A recording with long pauses goes through a graph without waiting for them."""

from __future__ import annotations

import time

import pytest
from scenes.small_site import SmallSite

from ltm_ros.replay.live import LivePlayer
from ltm_ros.replay.selection import Selection

pytestmark = pytest.mark.graph


def test_long_pauses_are_stepped_over(small_site: SmallSite, ros_domain: int) -> None:
    """Played a thousand times slower, 1.35 s of frames would take 22 minutes; the clock steps from frame to frame."""
    selection = Selection.open(small_site.bag, small_site.site)
    deadline = time.monotonic() + 120.0
    clock: list[int] = []
    with LivePlayer(selection, rate=0.001, longest_pause=0.2) as player:
        published = player.play(
            progress=lambda done: clock.append(player.now_ns()), stopped=lambda: time.monotonic() > deadline
        )
    assert published == selection.message_count
    logged = [message.log_time_ns for message in selection]
    assert clock == sorted(clock)
    late = [now - due for now, due in zip(clock, logged, strict=True)]
    assert min(late) >= 0
    assert max(late) < 0.1e9, "a message is published at its time, also after a step"
