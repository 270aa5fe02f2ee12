"""The turns that the towers of a region take."""

import threading

from ltm_ros.region.mqtt_link import KEPT_BYTES, Inbox
from ltm_ros.runtime.health import Health


def drained(inbox: Inbox) -> list[tuple[str, bytes]]:
    found = []
    while (came := inbox.get(0.0)) is not None:
        found.append(came)
    return found


def test_a_tower_that_floods_delays_no_other_towers_frames() -> None:
    health = Health()
    inbox = Inbox(["alta", "bear", "crow"], health)
    for number in range(50):
        inbox.put("alta", b"flood %d" % number)
    for number in range(2):
        inbox.put("bear", b"%d" % number)
        inbox.put("crow", b"%d" % number)
    came = drained(inbox)
    assert [tower for tower, _ in came[:7]] == ["alta", "bear", "crow", "alta", "bear", "crow", "alta"]
    assert [content for tower, content in came if tower == "alta"] == [b"flood %d" % number for number in range(50)]
    assert (len(came), inbox.size, health.dropped) == (54, 0, {})


def test_a_tower_whose_queue_is_full_loses_its_last_and_no_other_does() -> None:
    health = Health()
    inbox = Inbox(["alta", "bear"], health, most=10 * (KEPT_BYTES + 100))
    for number in range(30):
        inbox.put("alta", bytes([number]) * 100)
    assert health.dropped == {"overload": 20}
    for number in range(4):
        inbox.put("bear", bytes([number]) * 100)
    assert inbox.size == 14 * (KEPT_BYTES + 100)
    came = drained(inbox)
    assert [content[0] for tower, content in came if tower == "alta"] == list(range(10))
    assert [content[0] for tower, content in came if tower == "bear"] == [0, 1, 2, 3]
    assert "of alta are queued" in health.last_error


def test_any_number_of_names_that_are_no_towers_has_one_turn_and_is_bounded() -> None:
    health = Health()
    inbox = Inbox(["alta"], health, most=8 * KEPT_BYTES)
    for number in range(1000):
        inbox.put(f"unknown{number}", b"")
    inbox.put("alta", b"")
    came = [tower for tower, _ in drained(inbox)]
    assert came == ["alta", *(f"unknown{number}" for number in range(8))]
    assert health.dropped == {"overload": 992}
    inbox.put("alta" + 60_000 * "x", b"")
    ((name, _),) = drained(inbox)
    assert name == "alta" + 96 * "x"


def test_who_waits_is_woken() -> None:
    inbox, got = Inbox(["alta"], Health()), []
    thread = threading.Thread(target=lambda: got.append(inbox.get(60.0)))
    thread.start()
    inbox.put("alta", b"x")
    thread.join(60.0)
    assert got == [("alta", b"x")]
    assert inbox.get(0.01) is None
