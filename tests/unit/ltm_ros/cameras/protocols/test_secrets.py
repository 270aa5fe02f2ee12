import io
import logging
import traceback
from base64 import b64encode
from contextlib import redirect_stderr
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest
import yaml
from pydantic import SecretStr
from scenes.http_camera import Behaviour, HttpCamera, running
from scenes.outlets import Kept
from scenes.small_site import write_small_site
from scenes.source_under_test import Sourced, settings
from scenes.waiting import wait_for

from ltm_core.base.errors import ConfigError
from ltm_core.base.redaction import redacted
from ltm_core.site.site_io import load_site
from ltm_ros.cameras.protocols.credentials import Login, UnauthorisedError, read_secret
from ltm_ros.nodes.source import SourceHandler
from ltm_ros.runtime.clocks import SystemClock
from ltm_ros.runtime.handler import NodeConfig
from ltm_ros.runtime.health import Health

PASSWORD = "tower-%7 secret"
SPELLINGS = (PASSWORD, quote(PASSWORD), quote(PASSWORD, safe=""), b64encode(f"viewer:{PASSWORD}".encode()).decode())


def assert_silent(text: str) -> None:
    for spelling in SPELLINGS:
        assert spelling not in text


@pytest.mark.parametrize("place", ["environment", "file", "credential", "credential of the installed service"])
def test_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    monkeypatch.setenv("NORTH", PASSWORD)
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    file = tmp_path / ("ltm_north" if place.endswith("service") else "north")
    file.write_text(f"{PASSWORD}\n")
    place = place.partition(" ")[0]
    where = {"environment": "NORTH", "file": str(file), "credential": "north"}[place]
    config = settings(kind="snapshot", url="http://127.0.0.1/", user="viewer", password={place: where})
    secret = read_secret(config.password)
    assert Login.of(config).secret == secret.get_secret_value() == PASSWORD
    assert PASSWORD not in f"{secret} {secret!r} {[secret]}"
    monkeypatch.delenv("NORTH")
    monkeypatch.delenv("CREDENTIALS_DIRECTORY")
    file.write_text("")
    with pytest.raises(UnauthorisedError, match=r"NORTH|north"):
        read_secret(config.password)


FAULTY: dict[str, dict[str, Any]] = {
    "in the URL": {"url": f"http://viewer:{PASSWORD}@127.0.0.1/snapshot.jpg"},
    "as a parameter": {"url": f"http://127.0.0.1/api?cmd=Snap&password={quote(PASSWORD)}"},
    "as it is": {"user": "viewer", "password": PASSWORD},
    "as it is, unknown key": {"user": "viewer", "passwd": PASSWORD},
    "in a list": {"user": "viewer", "password": [PASSWORD]},
    "elsewhere wrong": {"user": "viewer", "password": PASSWORD, "every": -1},
}


@pytest.mark.parametrize("given", FAULTY.values(), ids=FAULTY)
def test_a_site_file_holds_no_password(tmp_path: Path, given: dict[str, Any]) -> None:
    small = write_small_site(tmp_path, recording=False)
    site = yaml.safe_load(small.path.read_text())
    site["cameras"]["mast"]["source"] = {"kind": "snapshot", "url": "http://127.0.0.1/snapshot.jpg"} | given
    small.path.write_text(yaml.safe_dump(site))
    with pytest.raises(ConfigError) as caught:
        load_site(small.path)
    said = "".join(traceback.format_exception(caught.value, chain=False))
    assert_silent(said)
    assert "cameras.mast" in said
    if "url" in given or given.get("password"):
        assert "environment: NAME" in said


def test_what_libraries_say_is_redacted() -> None:
    login = Login("viewer", SecretStr(PASSWORD))
    for text in (
        f"could not open rtsp://viewer:{quote(PASSWORD, safe='')}@127.0.0.1/live",
        f"GET http://127.0.0.1/api?user=viewer&password={quote(PASSWORD)}&rs=1 failed",
        f"Authorization: Basic {SPELLINGS[-1]}",
        f"bad value {PASSWORD!r}",
    ):
        assert_silent(login.redact(text))
    assert redacted("http://a:b@c/?token=xyz&x=1") == "http://***@c/?token=***&x=1"
    assert redacted("no connection: nothing listens") == "no connection: nothing listens"


BROKEN: dict[str, dict[str, Any]] = {
    "well": {},
    "refused": {"password": "another"},
    "hangs up": {"hang_up": True},
    "cut": {"cut": True},
    "error": {"status": 500},
    "no picture": {"garbage": b"<html>no</html>"},
    "sends on": {"status": 302, "location": f"http://viewer:{quote(PASSWORD)}@127.0.0.1/?password={quote(PASSWORD)}"},
}


@pytest.mark.parametrize("path", ["/snapshot.jpg", "/snapshot.jpg?user={user}&password={password}"])
@pytest.mark.parametrize("broken", BROKEN.values(), ids=BROKEN)
def test_nothing_that_a_source_says_holds_it(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, broken: dict[str, Any], path: str
) -> None:
    monkeypatch.setenv("NORTH", PASSWORD)
    caplog.set_level(logging.DEBUG)
    for name in ("httpx", "httpcore"):
        assert logging.getLogger(name).getEffectiveLevel() >= logging.WARNING
    with running(HttpCamera(Behaviour(authentication="digest"))) as camera:
        for name, value in broken.items():
            setattr(camera.behaviour, name, value)
        if "{password}" in path:
            camera.behaviour.authentication = ""
        config = settings(
            kind="snapshot", url=camera.url(path), every=1, user="viewer", password={"environment": "NORTH"}
        )
        sourced = Sourced(config, SystemClock())
        sourced.steps(2)
        if "{password}" in path and "password" not in broken and not camera.behaviour.hang_up:
            assert quote(PASSWORD, safe="") in camera.asked[0]
        sourced.source.report()
        said = f"{sourced.health.summary()} {sourced.why} {sourced.health.last_error} {config!r} {caplog.text}"
        assert_silent(said)
        assert_silent(str(sourced.frames))
        sourced.source.close()


def test_nor_what_the_node_publishes_and_prints_after_a_bug(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NORTH", PASSWORD)
    small = write_small_site(tmp_path, recording=False)
    site = yaml.safe_load(small.path.read_text())
    with running(HttpCamera(Behaviour(authentication="digest"))) as camera:
        del site["cameras"]["mast"]["image"]
        site["cameras"]["mast"]["calibration"] = {"width": 320, "height": 180, "hfov_deg": 62.0}
        site["cameras"]["mast"]["source"] = {
            "kind": "snapshot", "url": camera.url(), "every": 0.1, "user": "viewer",
            "password": {"environment": "NORTH"},
        }  # fmt: skip
        small.path.write_text(yaml.safe_dump(site))
        outlet, health, printed = Kept(), Health(), io.StringIO()
        node = SourceHandler(NodeConfig(site=str(small.path), camera="mast"), outlet, health)
        with redirect_stderr(printed):
            node.start()
            wait_for(lambda: len(outlet.sent) > 8, "frames", health.summary)

            def bug(*_: object) -> None:
                raise RuntimeError(f"a bug with http://viewer:{PASSWORD.split()[0]}@127.0.0.1/ in hand")

            monkeypatch.setattr("ltm_ros.cameras.camera_source.is_night", bug)
            wait_for(lambda: health.dropped.get("crash"), "the bug", health.summary)
            node.tick(0.5)
            node.finish()
        for text in (printed.getvalue(), str(outlet.sent), str(health.summary())):
            assert_silent(text)
            assert PASSWORD.split()[0] not in text
        assert "RuntimeError" in printed.getvalue()
