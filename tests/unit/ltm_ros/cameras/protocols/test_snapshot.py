import datetime
from pathlib import Path

import pytest
from scenes.http_camera import Behaviour, HttpCamera, certificate, running
from scenes.source_under_test import Sourced, settings
from scenes.timed_picture import exif_of, jpeg, scene

from ltm_ros.cameras.protocols.http_pictures import SnapshotReader
from ltm_ros.cameras.protocols.picture import Nothing
from ltm_ros.runtime.clocks import SystemClock


def reader(camera: HttpCamera, **given: object) -> SnapshotReader:
    return SnapshotReader(settings(kind="snapshot", url=camera.url(), **given), 4 << 20)


@pytest.mark.parametrize("offered", ["basic", "digest", "both"])
@pytest.mark.parametrize("chosen", ["auto", "basic", "digest"])
def test_authentication(monkeypatch: pytest.MonkeyPatch, offered: str, chosen: str) -> None:
    monkeypatch.setenv("NORTH", "tower-%7 secret")
    with running(HttpCamera(Behaviour(authentication=offered, locks_after=1))) as camera:
        asking = reader(camera, user="viewer", password={"environment": "NORTH"}, authentication=chosen)
        if chosen not in (offered, "auto") and offered != "both":
            with pytest.raises(Exception, match="rejected user viewer"):
                asking.read()
            return
        for _ in range(3):
            assert asking.read() not in (Nothing.YET, Nothing.UNCHANGED)
        # `auto` asks what is offered once, and never with a wrong password.
        assert camera.refused == 0
        asking.close()


def test_bytes_pass_untouched_and_unchanged_ones_are_not_sent_again() -> None:
    with running(HttpCamera(Behaviour(tags=True, frozen=True))) as camera:
        asking = reader(camera)
        picture = asking.read()
        assert picture.jpeg == camera.picture()[1]  # type: ignore[union-attr]
        assert asking.read() is Nothing.UNCHANGED
        camera.behaviour.frozen = False
        assert asking.read() not in (Nothing.UNCHANGED, Nothing.YET)
        asking.close()


@pytest.mark.parametrize(
    ("fraction", "zone", "resolution"), [("", "", 1.0), ("250", "-07:00", 0.001)], ids=["seconds", "fraction and zone"]
)
def test_exif_tells_the_time_of_exposure(fraction: str, zone: str, resolution: float) -> None:
    exif = exif_of("2026:08:01 12:00:05", fraction, zone)
    with running(HttpCamera(Behaviour(render=lambda _: jpeg(scene(), exif=exif)))) as camera:
        taken = reader(camera).read().timing.taken  # type: ignore[union-attr]
    hours = datetime.timedelta(hours=-7 if zone else 0)
    expected = datetime.datetime(2026, 8, 1, 12, 0, 5, 250_000 if fraction else 0, datetime.timezone(hours))
    assert (taken.told_by, taken.resolution) == ("exif", resolution)
    assert taken.epoch == pytest.approx(expected.timestamp(), abs=1e-3)


def test_a_certificate_is_checked_against_what_the_site_file_names(tmp_path: Path) -> None:
    right, other = certificate(tmp_path, "IP:127.0.0.1"), certificate(tmp_path, "DNS:camera")
    states = []
    for shown, ca, check_name in (
        (right, right, True), (right, other, True), (right, None, True), (other, other, True), (other, other, False)
    ):  # fmt: skip
        with running(certificate=shown) as camera:
            config = settings(
                kind="snapshot", url=camera.url(), every=1, check_name=check_name, **({"ca": ca[0]} if ca else {})
            )
            sourced = Sourced(config, SystemClock())
            sourced.steps(1)
            states.append(sourced.state)
            assert sourced.state == "alive" or "certificate" in sourced.why.lower()
    assert states == ["alive", "stalled", "stalled", "stalled", "alive"]


def test_a_locked_account_is_left_alone_for_ten_minutes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NORTH", "wrong")
    with running(HttpCamera(Behaviour(authentication="digest"))) as camera:
        config = settings(kind="snapshot", url=camera.url(), every=1, user="viewer", password={"environment": "NORTH"})
        sourced = Sourced(config, SystemClock())
        hour = 0.0
        while hour < 3600.0:
            (pause,) = sourced.steps(1)
            assert sourced.state == "unauthorised"
            hour += pause
        assert camera.refused <= 6
        monkeypatch.setenv("NORTH", camera.behaviour.password)
        sourced.steps(1)
        assert sourced.state == "alive"
