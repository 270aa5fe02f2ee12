from collections.abc import Callable, Iterator
from time import process_time
from typing import Any

import pytest
from pydantic import TypeAdapter
from scenes.http_camera import HttpCamera, running
from scenes.ptz_camera import FakeHead, ptz_camera

from ltm_core.site.source_config import PtzConfig
from ltm_ros.cameras.protocols.credentials import SourceError, UnauthorisedError
from ltm_ros.cameras.protocols.picture import PtzHead
from ltm_ros.cameras.ptz.head import found, parsed_xml
from ltm_ros.cameras.ptz.makers import OnvifPtzHead, open_ptz

KINDS: dict[str, dict[str, Any]] = {
    "vapix": {"kind": "vapix"},
    "isapi tenths": {"kind": "isapi", "units": "tenths"},
    "isapi degrees": {"kind": "isapi", "units": "degrees"},
    "onvif": {"kind": "onvif"},
}
DOWNWARDS = ("isapi tenths", "isapi degrees")
PASSWORD = "tower-%7 <&> secret"


def config(**given: Any) -> Any:
    adapter: TypeAdapter[Any] = TypeAdapter(PtzConfig)
    return adapter.validate_python(given)


def opened(camera: HttpCamera, kind: str, **given: Any) -> PtzHead:
    return open_ptz(config(**KINDS[kind], url=camera.url(""), **given), None)


@pytest.fixture
def turning() -> Iterator[tuple[FakeHead, HttpCamera]]:
    head = FakeHead(place=(123.4, -7.2, 500.0))
    with running(ptz_camera(head)) as camera:
        yield head, camera


Turning = tuple[FakeHead, HttpCamera]


@pytest.mark.parametrize("kind", KINDS)
def test_a_head_says_where_it_looks(turning: Turning, kind: str) -> None:
    reading = opened(turning[1], kind).read()
    assert reading.pan_deg == pytest.approx(123.4, abs=0.06)
    assert reading.tilt_deg == pytest.approx(7.2 if kind in DOWNWARDS else -7.2, abs=0.06)
    zoom = {"isapi tenths": 5000.0, "onvif": 499 / 9998}.get(kind, 500.0)
    assert reading.zoom == pytest.approx(zoom, rel=1e-4)
    assert reading.moving is None


def test_onvif_s_scale_and_inversion_are_the_model_s(turning: Turning) -> None:
    fake, camera = turning
    fake.onvif_inverted = True
    assert opened(camera, "onvif").read().pan_deg == pytest.approx(-123.4, abs=0.01)
    right = opened(camera, "onvif", pan_range_deg=(180.0, -180.0))
    assert right.read().pan_deg == pytest.approx(123.4, abs=0.01)
    narrow = opened(camera, "onvif", pan_range_deg=(-90.0, 90.0))
    assert narrow.read().pan_deg == pytest.approx(-61.7, abs=0.01)


@pytest.mark.parametrize(("says", "moving"), [(None, None), ("UNKNOWN", None), ("IDLE", None), ("MOVING", True)])
def test_onvif_s_move_status_is_believed_only_where_it_says_moving(
    turning: Turning, says: str | None, moving: bool | None
) -> None:
    turning[0].move_status = says
    assert opened(turning[1], "onvif").read().moving is moving


@pytest.mark.parametrize("ahead", [0.0, 120.0, -120.0, -50 * 365 * 86400.0])
def test_a_camera_whose_clock_is_wrong_is_signed_to_by_its_own_time(turning: Turning, ahead: float) -> None:
    fake, camera = turning
    fake.clock_ahead, fake.user, fake.password = ahead, "viewer", PASSWORD
    head = opened(camera, "onvif", **_login())
    assert isinstance(head, OnvifPtzHead)
    assert head.read().pan_deg == pytest.approx(123.4, abs=0.01)
    assert head.soap.clock_ahead() == pytest.approx(ahead, abs=1.0)


@pytest.mark.parametrize("time", ["signed", "none"])
def test_a_camera_that_tells_its_time_only_signed_or_not_at_all(turning: Turning, time: str) -> None:
    fake, camera = turning
    fake.time, fake.user, fake.password = time, "viewer", PASSWORD
    assert opened(camera, "onvif", **_login()).read().pan_deg == pytest.approx(123.4, abs=0.01)


@pytest.fixture(autouse=True)
def _secret(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HEAD_PASSWORD", PASSWORD)
    monkeypatch.setenv("WRONG_PASSWORD", "not-the-one")


def _login(name: str = "HEAD_PASSWORD") -> dict[str, Any]:
    return {"user": "viewer", "password": {"environment": name}}


@pytest.mark.parametrize("kind", KINDS)
def test_a_wrong_password_is_told_without_it_and_a_right_one_works(turning: Turning, kind: str) -> None:
    fake, camera = turning
    if kind == "onvif":
        fake.user, fake.password = "viewer", PASSWORD
    else:
        camera.behaviour.authentication, camera.behaviour.password = "digest", PASSWORD
    with pytest.raises(UnauthorisedError, match="rejected user viewer") as told:
        opened(camera, kind, **_login("WRONG_PASSWORD")).read()
    assert "not-the-one" not in str(told.value)
    assert opened(camera, kind, **_login()).read().pan_deg == pytest.approx(123.4, abs=0.06)


def _answering(body: bytes, status: int = 200) -> Callable[[Any], None]:
    return lambda request: request.answer(status, body, "text/html")


BOMB = b'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;">]><x>&b;</x>'


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b"<html>log in</html>", 200),
        (b"", 200),
        (b"\xff\x00pan", 200),
        (b"pan=NaN\r\ntilt=1\r\nzoom=1", 200),
        (BOMB, 200),
        (b"[" * 5000, 200),
        (b"no", 404),
        (b"no", 500),
    ],
    ids=["page", "empty", "bytes", "nan", "bomb", "deep", "404", "500"],
)
def test_what_is_no_answer_is_told_as_such(turning: Turning, kind: str, body: bytes, status: int) -> None:
    _, camera = turning
    camera.routes = dict.fromkeys(camera.routes, _answering(body, status))
    with pytest.raises(SourceError):
        opened(camera, kind).read()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-16-le", "utf-16-be"])
def test_a_document_type_is_seen_in_every_encoding(encoding: str) -> None:
    with pytest.raises(SourceError, match="document type"):
        parsed_xml(BOMB.decode().encode(encoding))


def test_elements_nested_thousands_of_times_are_searched_in_a_moment() -> None:
    root, begin = parsed_xml(b"<PTZ>" * 20_000 + b"</PTZ>" * 20_000), process_time()
    assert found(root, "PTZ", "XAddr") is None
    assert process_time() - begin < 2.0


def test_an_answer_without_end_is_not_read_to_it(turning: Turning) -> None:
    _, camera = turning
    camera.routes = dict.fromkeys(camera.routes, _answering(b"x=1\n" * 400_000))
    with pytest.raises(SourceError, match="more than"):
        opened(camera, "vapix").read()
