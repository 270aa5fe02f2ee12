import pytest

from ltm_ros.runtime import health as module
from ltm_ros.runtime.health import Health


def test_a_frame_has_a_message_on_each_topic() -> None:
    health = Health()
    for _ in range(4):
        for topic in ("posed/image", "posed/pose", "posed/camera_info"):
            health.received(topic)
    health.received("posed/pose")
    health.published("depth/image")
    summary = health.summary()
    assert (summary["frames_in"], summary["received"]) == ("5", "13")
    assert (summary["frames_out"], summary["published"]) == ("1", "1")


def test_frames_of_several_cameras_add_up_and_site_topics_are_none() -> None:
    health = Health()
    for topic, count in {
        "/ridge/north/fuel/votes": 3,
        "/ridge/north/labels/image": 2,
        "/ridge/south/fuel/votes": 4,
        "/ridge/fuel_map": 50,
        "/ridge/fuel_map/update": 60,
        "/diagnostics": 70,
    }.items():
        for _ in range(count):
            health.received(topic)
    assert health.summary()["frames_in"] == "7"


def test_drops_are_counted_by_cause_and_the_last_is_quoted() -> None:
    health = Health()
    health.drop("pose", "no quaternion")
    health.drop("image", "garbage")
    health.drop("image", "cut short")
    health.note("out_of_order")
    summary = health.summary()
    assert {k: v for k, v in summary.items() if "drop" in k or "noted" in k} == {
        "dropped": "3",
        "dropped.image": "2",
        "dropped.pose": "1",
        "noted.out_of_order": "1",
    }
    assert summary["last_error"] == "image: cut short"
    assert health.troubled
    assert health.dropped == {"pose": 1, "image": 2}


def test_trouble_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 1000.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    health = Health()
    health.drop("image", "garbage")
    now += 9.0
    assert health.troubled
    now += 2.0
    assert not health.troubled
    assert health.summary()["last_error"] == "image: garbage"
    assert health.message == "ok"
    health.lasting("unauthorised: HTTP 401")
    now += 600.0
    assert (health.troubled, health.message) == (True, "unauthorised: HTTP 401")
    health.lasting("")
    assert not health.troubled


def test_latencies_in_milliseconds_of_the_last_messages() -> None:
    health = Health()
    health.published("depth/image", 1, 1)
    for number in range(50 + module.WINDOW):
        stamp = 10**10 * (number + 1)
        age_ms = 5000 if number < 50 else 10 if number < 200 else 250
        health.published("depth/image", stamp, stamp + age_ms * 10**6)
    health.published("depth/camera_info", None)
    health.worked(0.004)
    summary = health.summary()
    assert (summary["latency_p50_ms"], summary["latency_p95_ms"]) == ("10.0", "250.0")
    assert (summary["work_p50_ms"], summary["work_p95_ms"]) == ("4.0", "4.0")
