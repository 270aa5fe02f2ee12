from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from PIL import Image
from scenes.http_camera import HttpCamera, running
from scenes.ptz_camera import FakeHead, ptz_camera
from scenes.small_site import TOWER, Frame, SmallSite, write_small_site
from typer.testing import CliRunner

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.mount.mount_io import read_readings
from ltm_core.site.site_io import load_site
from ltm_core.tracing.trace_io import load_picture_config
from ltm_ros.cameras.protocols.credentials import UnauthorisedError
from ltm_ros.cli import cameras
from ltm_ros.cli.main import cli

PASSWORD = "tower-%7 <&> secret"


def run(*arguments: object, typed: str | None = None) -> str:
    environment = {"COLUMNS": "200", "HEAD_PASSWORD": PASSWORD, "WRONG": "not-the-one"}
    result = CliRunner().invoke(cli, ["cameras", *map(str, arguments)], input=typed, env=environment)
    assert PASSWORD not in result.output
    assert "not-the-one" not in result.output
    if isinstance(result.exception, LtmError):
        assert PASSWORD not in str(result.exception)
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture
def head() -> FakeHead:
    return FakeHead(place=(123.4, -7.2, 1.0), rate=3000.0)


@pytest.fixture
def camera(head: FakeHead) -> Iterator[HttpCamera]:
    with running(ptz_camera(head)) as camera:
        yield camera


@pytest.fixture
def small(tmp_path: Path) -> SmallSite:
    """Its site file in lines, so that a camera can be put into it."""
    return write_small_site(tmp_path, recording=False)


POSE = ("--lonlat", "-117.227,37.502", "--height", 20, "--azimuth", 48, "--pitch", -12)


@pytest.mark.parametrize(
    "cameras",
    [
        "cameras:\n  tower: {}   # mine\n",
        "",
        "cameras: {}\n",
        "cameras:\n  north: {}\n",
        "cameras:\n  north:   # mine\n    label_head: mine\n",
    ],
    ids=["another camera", "no section", "no camera", "README", "begun"],
)
def test_probe_adds_a_camera_to_every_site_file_and_completes_it(small: SmallSite, cameras: str) -> None:
    given = yaml.safe_load(small.path.read_text())
    del given["cameras"]
    small.path.write_text(f"# my site\n{yaml.safe_dump(given)}{cameras}")
    with running() as camera:
        camera.behaviour.clock_ahead = 37.0
        camera.behaviour.authentication, camera.behaviour.password = "digest", PASSWORD
        login = ("--user", "viewer", "--password-env", "HEAD_PASSWORD", "--site", small.path, "--camera", "north")
        said = run("probe", camera.url(), *login, *POSE, "--hfov", 62)
        again = run("probe", camera.url(), *login)  # position and lens are in the file now
        with pytest.raises(ConfigError, match="already has calibration"):
            run("probe", camera.url(), *login, "--hfov", 50)
        run("probe", camera.url(), *login, "--hfov", 50, "--replace")
    assert "320 x 180 pixels" in said
    assert "+37." in said or "+36." in said
    assert "still to be added" not in said + again
    site = load_site(small.path)
    north = site.camera("north")
    assert north.source is not None
    assert north.source.model_dump()["url"] == camera.url()
    assert north.pose is not None
    assert north.pose.azimuth_deg == 48.0
    assert north.calibration is not None
    assert (north.calibration.width, north.calibration.hfov_deg) == (320, 50.0)
    assert north.label_head == ("mine" if "label_head" in cameras else "landscape")
    assert set(site.cameras) == {"north", *({"tower"} if "tower" in cameras else ())}
    written = small.path.read_text()
    assert PASSWORD not in written
    assert "# my site" in written
    assert ("# mine" in cameras) is ("# mine" in written)


def test_probe_takes_the_password_nowhere_but_to_the_host_that_was_named(camera: HttpCamera, head: FakeHead) -> None:
    """A camera without a PTZ head states an address of its pictures by ONVIF: another host's, or of its own behind a
    gateway."""
    head.has_ptz = False
    camera.routes = {path: route for path, route in camera.routes.items() if path.startswith("/onvif")}
    camera.behaviour.authentication, camera.behaviour.password = "basic", PASSWORD
    login = ("--user", "viewer", "--password-env", "HEAD_PASSWORD")
    with running() as elsewhere:
        elsewhere.behaviour.authentication, elsewhere.behaviour.password = "basic", PASSWORD
        head.stated_picture = f"http://guest:hidden@127.0.0.1:{elsewhere.port}/snapshot.jpg?channel=1"
        said = run("probe", camera.url("/none.jpg"), *login)
        assert elsewhere.asked == []
    assert "/snapshot.jpg?channel=1" in camera.asked
    assert f"url: {camera.url('/snapshot.jpg')}?channel=1" in said
    assert "hidden" not in said


def test_an_address_that_cannot_be_asked_is_told_and_the_head_is_found_all_the_same(
    camera: HttpCamera, head: FakeHead
) -> None:
    camera.routes = {path: route for path, route in camera.routes.items() if path.startswith("/onvif")}
    for stated in ("http://[::1/snapshot.jpg", "http://{}/snapshot.jpg?pwd=hidden"):
        head.stated_picture = stated
        said = run("probe", camera.url("/none.jpg"))
        assert "kind: onvif" in said
        assert "invalid address" in said or "cannot be taken" in said
        assert "pwd=hidden" not in said


def test_what_a_camera_says_is_text_and_no_markup(camera: HttpCamera, head: FakeHead) -> None:
    camera.routes = {path: route for path, route in camera.routes.items() if path.startswith("/onvif")}
    head.stated_picture = "http://{}/[/][bold]north.jpg"
    assert "[/][bold]north.jpg" in run("probe", camera.url("/none.jpg"))


def test_a_wrong_password_is_tried_once(camera: HttpCamera) -> None:
    camera.behaviour.authentication, camera.behaviour.password = "digest", PASSWORD
    with pytest.raises(UnauthorisedError, match=r"rejected user viewer[\s\S]*Probing stopped"):
        run("probe", camera.url(), "--user", "viewer", "--password-env", "WRONG")
    assert camera.refused == 1
    assert not camera.asked


def test_a_password_is_typed_and_neither_shown_nor_written(camera: HttpCamera) -> None:
    camera.behaviour.authentication, camera.behaviour.password = "digest", PASSWORD
    said = run("probe", camera.url(), "--user", "viewer", "--azimuth", 3, typed=f"{PASSWORD}\n")
    assert "environment: LTM_NORTH_PASSWORD" in said
    assert "export LTM_NORTH_PASSWORD=..." in said


@pytest.mark.parametrize(("folder", "kept"), [("credentials", "credential: north"), ("elsewhere", "file: ")])
def test_a_password_of_an_installed_tower_is_named_as_a_credential(
    camera: HttpCamera, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str, kept: str
) -> None:
    camera.behaviour.authentication, camera.behaviour.password = "digest", PASSWORD
    monkeypatch.setattr(cameras, "CREDENTIALS", tmp_path / "credentials")
    (tmp_path / folder).mkdir()
    (tmp_path / folder / "north").write_text(PASSWORD)
    assert kept in run("probe", camera.url(), "--user", "viewer", "--password-file", tmp_path / folder / "north")


@pytest.mark.parametrize(
    "url", ["http://u:s3cret@127.0.0.1/a.jpg", "rtsp://u:s3cret@127.0.0.1", "127.0.0.1/?pwd=s3cret"]
)
def test_a_password_in_the_address_is_refused_without_repeating_it(url: str) -> None:
    with pytest.raises(ConfigError, match="--password-env") as told:
        run("probe", url)
    assert "s3cret" not in str(told.value)
    with pytest.raises(ConfigError, match=r"^ftp://camera: expected a URL") as told:
        run("probe", "ftp://camera")
    assert "--password-env" not in str(told.value)


MOUNT = {"x": 480_575.0, "y": 4_150_485.0, "height_above_ground": 45.0, "azimuth_deg": 30.0, "pitch_deg": 0.4}
LENS = {
    "width": TOWER.width,
    "height": TOWER.height,
    "zoom": [{"zoom": 1, "hfov_deg": 62.0}, {"zoom": 9999, "hfov_deg": 4}],
}


def write_label_head(small: SmallSite, camera: HttpCamera, **ptz: object) -> None:
    """The tower of the small site becomes a PTZ head that is asked by VAPIX."""
    content = yaml.safe_load(small.path.read_text())
    content["cameras"]["tower"] = {
        "source": {"kind": "snapshot", "url": camera.url(), "every": 0.2},
        "ptz": {"kind": "vapix", **ptz},
        "mount": {**MOUNT, "lens": LENS},
    }
    small.path.write_text(yaml.safe_dump(content, sort_keys=False))


def test_snapshot_writes_picture_pose_and_reading(tmp_path: Path, head: FakeHead) -> None:
    small = write_small_site(tmp_path, recording=False)
    head.place = (95.0, -14.0, 1.0)
    head.send(head.place)
    with running(ptz_camera(head, lambda place: seen)) as camera:
        write_label_head(small, camera)
        mount = load_site(small.path).camera("tower").mount
        assert mount is not None
        model = mount.model(small.dem, small.site.frame)
        pose = Pose(model.base.position, model.rotation(*head.place[:2]))
        # Drawn beforehand: kernels that are yet to be compiled take longer than a camera may.
        seen = small.photo(Frame("tower", 0, TOWER, pose))
        out = tmp_path / "out"
        said = run("snapshot", small.path, "tower", "--out", out, "--name", "east")
        run("snapshot", small.path, "tower", "--out", out, "--name", "again")
        with pytest.raises(ConfigError, match="exists already"):
            run("snapshot", small.path, "tower", "--out", out, "--name", "east")
    assert "pan 95.000, tilt -14.000" in said
    assert read_readings(out / "readings.csv") == {"east.jpg": (95.0, -14.0, 1.0), "again.jpg": (95.0, -14.0, 1.0)}
    config = load_picture_config(out / "east.yaml")
    # The mount pitches up by 0.4 deg at pan 0, and so hardly at pan 95.
    assert config.pose.azimuth_deg == pytest.approx(125.0, abs=0.2)
    assert config.pose.pitch_deg == pytest.approx(-14.0, abs=0.1)
    assert config.calibration.fx == pytest.approx(TOWER.fx, rel=1e-3)
    assert config.pose.azimuth_sigma_deg == pytest.approx(1.5, rel=0.1)
    with Image.open(out / "east.jpg") as photo:
        assert photo.size == (TOWER.width, TOWER.height)
