import pytest
from scenes.tower_words import NODES, NOW_S, healths, status_of, watch_of

from ltm_ros.nodes.health import camera_diagnostic
from ltm_ros.runtime.health import CameraState, Health
from ltm_ros.tower.metrics import exposition
from ltm_ros.tower.tower_status import KEYS, LENGTH, CameraStatus, OutboxState, TowerWatch


def test_a_tower_that_has_not_begun_is_neither_alive_nor_ready() -> None:
    status = status_of(TowerWatch("ridge", NODES, 120.0))
    assert (status.alive, status.ready) == (False, False)
    assert {node.state for node in status.nodes} == {"missing"}
    assert any("/ridge/fuel_map no report yet" in line for line in status.wrong)
    assert any("north: no frame since the start" in line for line in status.wrong)


def test_what_is_wrong_is_said_in_words() -> None:
    status = status_of(watch_of(healths()))
    north, east = status.cameras
    assert (north.frame_age_s, north.dropped) == (4.5, {"shed": 3, "no_pose": 2})
    assert north.wrong == ""
    assert east.wrong == "east: no new frame for 12 min"
    assert status.alive
    assert not status.ready
    assert any("not synchronised" in line for line in status.wrong)
    assert any("/state: 2.0 GB free of 100 GB" in line for line in status.wrong)
    assert any("/gone: does not exist" in line for line in status.wrong)


def test_an_outbox_that_nobody_empties_is_said_in_words() -> None:
    made = healths()
    status = status_of(watch_of(made))
    assert status.outbox == OutboxState(412, 5_130_000, 7260.5, link_up=False)
    assert (
        "no connection to the region's map: 412 frames are queued in the outbox, the oldest for 2.0 h" in status.wrong
    )
    made["/ridge/uplink"].gauge("link_up", 1)
    assert not any("region" in line for line in status_of(watch_of(made)).wrong)
    assert status_of(TowerWatch("ridge", NODES, 120.0)).outbox is None


@pytest.mark.parametrize(("now_s", "alive"), [(59.9, True), (60.1, False)])
def test_a_node_that_falls_silent_is_missed(now_s: float, alive: bool) -> None:
    status = status_of(watch_of(healths()), now_s)
    assert status.alive is alive
    assert {node.state for node in status.nodes} <= ({"ok", "warning"} if alive else {"silent"})


def test_a_camera_clock_far_ahead_is_no_fresh_frame() -> None:
    made = healths()
    for camera in ("north", "east"):
        made[f"/ridge/{camera}/capture"].gauge("newest_stamp", "1749999999.0")
    assert status_of(watch_of(made)).ready
    made["/ridge/north/capture"].gauge("newest_stamp", "1750007300.0")
    (said,) = [c.wrong for c in status_of(watch_of(made)).cameras if c.name == "north"]
    assert not status_of(watch_of(made)).ready
    assert said == "north: the camera's clock is 2.0 h ahead of the system clock"


def test_strangers_are_not_listened_to_and_words_are_bounded() -> None:
    watch = TowerWatch("ridge", NODES, 120.0)
    watch.hear("/ridge/west/capture", False, "ok", {"frames_in": "1"}, 1.0)
    assert {node.state for node in status_of(watch).nodes} == {"missing"}
    watch.hear(NODES[0], False, "x" * 10_000, {f"k{n}": "9" * 10_000 for n in range(10_000)}, 1.0)
    first = status_of(watch).nodes[0]
    assert len(first.values) == KEYS
    assert max(map(len, first.values.values())) == LENGTH
    assert first.number("k1") is None, "a number too large to be one"


SOURCES = (*NODES, "/ridge/north/source")
REFUSED = "192.0.2.20 rejected user viewer (HTTP 401). Check the user name and password"
SINCE = NOW_S - 50.0


def of_source(age_s: float, **said: object) -> tuple[TowerWatch, CameraStatus]:
    """Camera north with a source: what its state is while its newest frame is so old."""
    made = healths()
    made["/ridge/north/capture"].gauge("newest_stamp", f"{NOW_S - age_s:.3f}")
    made["/ridge/north/source"] = Health()
    for key, value in said.items():
        made["/ridge/north/source"].gauge(key, value)
    watch = TowerWatch("ridge", SOURCES, frame_limit_s=120.0)
    for name, health in made.items():
        watch.hear(name, health.troubled, health.message, health.summary(), now_s=50.0)
    return watch, watch.cameras(51.0, NOW_S)[0]


@pytest.mark.parametrize(
    ("age_s", "said", "state", "why"),
    [
        (4.5, {"state": "unauthorised", "state_why": REFUSED}, "unauthorised", REFUSED),
        (4.5, {"state": "alive"}, "alive", ""),
        (4.5, {"state": "alive", "state_why": "no connection"}, "alive", "no connection"),
        (9000.0, {"state": "night", "state_why": "dark"}, "night", "dark"),
        (150.0, {"state": "alive"}, "stalled", "no new frame for 2 min"),
        (150.0, {"state": "alive", "stalled_after_s": 900}, "alive", ""),
        (150.0, {"state": "moved", "state_why": "moving"}, "stalled", "no new frame for 2 min (moving)"),
        (-7200.0, {"state": "alive"}, "stalled", "the camera's clock is 2.0 h ahead of the system clock"),
        (4.5, {"state": "connecting"}, "connecting", "no image yet"),
        (4.5, {"state": "nonsense"}, "connecting", "source: ok"),
        (4.5, {}, "connecting", "source: ok"),
    ],
)
def test_a_camera_has_the_state_of_its_source(age_s: float, said: dict[str, object], state: str, why: str) -> None:
    watch, camera = of_source(age_s, state_since=SINCE, **said)
    assert (camera.state, camera.why) == (state, why)
    sending = state in ("alive", "night")
    assert (camera.wrong == "") is sending
    assert camera.since_s == (SINCE if said.get("state") == state else NOW_S)
    diagnostic = camera_diagnostic("ridge", camera)
    assert diagnostic.name == "/ridge/north"
    assert diagnostic.level == (b"\0" if sending else b"\1" if state == "connecting" else b"\2")
    assert {pair.key: pair.value for pair in diagnostic.values}["state"] == state
    scraped = exposition(status_of(watch)).decode()
    shown = [one.value for one in CameraState if f'ltm_camera_state{{camera="north",state="{one}"}} 1.0' in scraped]
    assert shown == [state]
    assert status_of(watch).as_dict()["cameras"][0]["state"] == state


@pytest.mark.parametrize("since", ["-1e300", "1e300", "nan", "noon"])
def test_a_beginning_that_is_no_time_is_not_believed(since: str) -> None:
    _, camera = of_source(4.5, state="alive", state_since=since)
    assert camera.since_s == NOW_S
    assert camera_diagnostic("ridge", camera).message.startswith("alive since")
