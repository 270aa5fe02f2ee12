import json
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing
from io import BytesIO
from typing import Any
from urllib.request import urlopen

import cv2
import numpy as np
import pytest
from scenes.waiting import wait_for

from ltm_core.base.errors import ConfigError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.vision.labels import LabelSet
from ltm_ros.runtime.web_server import WebResponse, WebServer
from ltm_ros.tower.health_client import RejectedError, TowerPort
from ltm_ros.tower.last_pictures import CameraPicture
from ltm_ros.tower.live_stream import FIRST_LINE, KINDS, LiveStream
from ltm_ros.tower.tower_mirror import StreamError, TowerMirror, _records, reached

LABELS = LabelSet.load()
TOKEN = "0123456789abcdef-token"


def picture(camera: str, second: int, seed: int = 0) -> CameraPicture:
    """A frame with detail, as a forest has it."""
    rng = np.random.default_rng(seed + second)
    photo = cv2.resize(rng.integers(0, 255, (90, 160, 3), np.uint8), (800, 450))
    labels = cv2.resize(rng.integers(0, 3, (9, 16), np.uint8), (800, 450), interpolation=cv2.INTER_NEAREST)
    depth = np.linspace(50, 5000, 800 * 450, dtype=np.float32).reshape(450, 800)
    optics, pose = Camera.from_fov(800, 450, 50.0), Pose.from_angles((0.0, 0.0, 0.0), 0.0, 0.0)
    return CameraPicture(camera, second * 1_000_000_000, np.asarray(photo), np.asarray(labels), depth, optics, pose)


class Scene:
    """What a status page shows, set by the test."""

    def __init__(self, *cameras: str) -> None:
        self.frames = {camera: picture(camera, 1) for camera in cameras}
        self.map: bytes | None = None

    def shown(self, camera: str) -> CameraPicture | None:
        return self.frames.get(camera)

    def stamps_s(self) -> dict[str, float]:
        return {name: frame.stamp_ns / 1e9 for name, frame in self.frames.items()}

    def map_png(self) -> bytes | None:
        return self.map

    def jpegs(self, picture: CameraPicture, width: int) -> list[bytes]:
        return [picture.resized(width).jpeg(kind, LABELS, 60) for kind in KINDS]

    def page(self) -> dict[str, Any]:
        return {"site": "ridge", "pictures": self.stamps_s()}


def test_every_camera_and_the_map_are_sent_once_until_they_change(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ltm_ros.tower.live_stream.PAGE_S", 1e9)  # one page, however slow the machine is
    monkeypatch.setattr("ltm_ros.tower.live_stream.MAP_S", 0.0)
    scene: Any = Scene("north", "east")
    scene.map = b"a map"
    records = LiveStream(scene.page, scene, pytest.fail, rate=1e9)._records()
    assert next(records) == FIRST_LINE

    def take(count: int) -> list[tuple[Any, bytes]]:
        return list(_records(BytesIO(FIRST_LINE + b"".join(next(records) for _ in range(count)))))

    first = take(4)
    assert [record.kind for record, _ in first] == ["page", "frame", "map", "frame"]
    assert first[2][1] == b"a map"
    assert {record.camera for record, _ in first if record.kind == "frame"} == {"north", "east"}
    assert json.loads(zlib.decompress(first[0][1]))["site"] == "ridge"
    scene.frames["east"] = picture("east", 2)
    ((record, content),) = take(1)
    assert (record.camera, record.stamp_s) == ("east", 2.0)
    assert content[: record.sizes[0]].startswith(b"\xff\xd8"), "the photo is first"
    scene.map = b"another"
    assert [(record.kind, content) for record, content in take(1)] == [("map", b"another")]


@pytest.fixture
def tower() -> Iterator[tuple[Scene, WebServer]]:
    scene: Any = Scene("north")
    scene.map = b"a map"
    live = LiveStream(scene.page, scene, pytest.fail, rate=1e6)
    routes = {
        "GET /live": lambda _: WebResponse(b"", "application/octet-stream", stream=live.stream()),
        "POST /mark": lambda body: WebResponse.json({"u": 1.0, "v": 2.0, "got": json.loads(body)}),
    }
    server = WebServer(routes, token=TOKEN)  # type: ignore[arg-type]
    yield scene, server
    server.close()


def port_of(server: WebServer, token: str = TOKEN) -> Callable[[], TowerPort]:
    return lambda: TowerPort("127.0.0.1", server.port, token=token)


def test_the_page_of_a_tower_is_served_here_and_follows_it(tower: tuple[Scene, WebServer]) -> None:
    scene, server = tower
    with closing(TowerMirror(port_of(server))) as mirror:

        def get(path: str) -> bytes:
            with urlopen(mirror.url + path, timeout=20) as answer:
                return bytes(answer.read())

        assert mirror.url.startswith("http://127.0.0.1:")
        wait_for(lambda: mirror.stamps_s() == {"north": 1.0}, "the first frame")
        assert b"<title>LTM tower</title>" in get("/")
        wait_for(lambda: mirror._page is not None, "the page")
        said = json.loads(get("/page.json"))
        assert (said["site"], said["pictures"]) == ("ridge", {"north": 1.0})
        for kind in KINDS:
            assert get(f"/picture/north/{kind}.jpg").startswith(b"\xff\xd8")

        wait_for(lambda: "GET /map.png" in mirror._routes, "the map")
        assert get("/map.png") == b"a map"
        scene.frames["north"] = picture("north", 7)
        wait_for(lambda: mirror.stamps_s() == {"north": 7.0}, "the next frame")


def test_a_wrong_token_is_rejected_at_once(tower: tuple[Scene, WebServer]) -> None:
    with pytest.raises(RejectedError, match="401"):
        TowerMirror(port_of(tower[1], "another token of sixteen"))


def test_a_tower_that_is_lost_is_stated_and_found_again(tower: tuple[Scene, WebServer]) -> None:
    scene, server = tower
    with closing(TowerMirror(port_of(server))) as mirror:
        wait_for(lambda: mirror._page is not None, "the page")
        server.close()
        for thread_socket in list(server._server._ends):
            thread_socket.shutdown(2)
        wait_for(lambda: mirror._page is None, "the loss to be noticed")
        assert mirror._page_json().status == 503
        live = LiveStream(scene.page, scene, pytest.fail, rate=1e6)
        routes = {"GET /live": lambda _: WebResponse(b"", stream=live.stream())}
        again = WebServer(routes, port=server.port, token=TOKEN)
        wait_for(lambda: mirror._page is not None, "the tower again")
        again.close()


@pytest.mark.parametrize(
    "content",
    [
        b"ltm live 1\n",
        FIRST_LINE + b"no JSON\n",
        FIRST_LINE + b'{"kind": "page", "bytes": 99999999999}\n',
        FIRST_LINE + b'{"kind": "frame", "bytes": 0, "camera": "../../etc"}\n',
        FIRST_LINE + b'{"kind": "tile", "bytes": 0}\n',
        FIRST_LINE + b"{" * 5000,
    ],
)
def test_what_is_no_stream_is_an_error(content: bytes) -> None:
    with pytest.raises(StreamError):
        list(_records(BytesIO(content)))


@pytest.mark.parametrize("tower", ["-oProxyCommand=x", "a b", "host:ssh", "host;ls", "ftp://host", "http://192.0.2.7"])
def test_an_address_that_is_none_is_an_error(tower: str) -> None:
    with pytest.raises(ConfigError), reached(tower, None, None):
        pass
