import threading
import time

import pytest
from bystander import Bystander
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from scenes.small_site import SmallSite
from scenes.waiting import wait_for

from ltm_ros.recordings.replay.offline import Selection
from ltm_ros.recordings.replay.run import LivePlayer

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


def waiting(frames: int) -> DiagnosticArray:
    """What a camera's capture says while so many of its frames wait at the door."""
    values = [KeyValue(key="waiting", value=str(frames)), KeyValue(key="queue", value="0")]
    return DiagnosticArray(status=[DiagnosticStatus(name="/hollow/tower/capture", values=values)])


def test_time_stands_still_while_a_graph_is_behind(small_site: SmallSite, ros_domain: int) -> None:
    selection = Selection.open(small_site.bag, small_site.site)
    published: list[int] = []
    clock: list[int] = []
    former = [-1]
    with Bystander() as bystander, LivePlayer(selection, rate=5.0) as player:

        def told() -> bool:
            bystander.send("/diagnostics", waiting(9))
            return bool(player.summaries)

        def stands_still() -> bool:
            bystander.send("/diagnostics", waiting(9))
            before, former[0] = former[0], player.now_ns()
            return before == former[0]

        def progress(done: int) -> None:
            published.append(done)
            clock.append(player.now_ns())

        bystander.open("/diagnostics", DiagnosticArray, listeners=2)
        wait_for(told, "word of the frames that wait")
        playing = threading.Thread(target=lambda: player.play(progress=progress), daemon=True)
        playing.start()
        wait_for(stands_still, "the clock to stand still")
        assert published == []
        bystander.send("/diagnostics", waiting(2))
        wait_for(lambda: len(published) == selection.message_count, "the recording to go on")
        playing.join()
    assert clock == sorted(clock)
    logged = [message.log_time_ns for message in selection]
    assert all(now >= due for now, due in zip(clock, logged, strict=True))
