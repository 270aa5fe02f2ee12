import http.client
import json
import shutil
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

import numpy as np
import pytest
from PIL import Image

from ltm_core.vision.areas import read_areas
from ltm_core.vision.segmenter import Segmenter
from ltm_ros.labelling.server import MOST_BYTES, LabelServer, LabelSession

WIDTH, HEIGHT = 320, 200
SHAPES = {"shapes": [{"kind": "polygon", "name": "sky", "points": [[0, 0], [300, 0], [300, 90]]}]}


@pytest.fixture
def server(tmp_path: Path) -> Iterator[LabelServer]:
    folder = tmp_path / "photos"
    folder.mkdir()
    rows = np.arange(HEIGHT)[:, None, None]
    photo = np.where(rows < 90, [120, 170, 230], [90, 110, 60]) + np.zeros((1, WIDTH, 1))
    for name in ("a.png", "b.png"):
        Image.fromarray(photo.astype(np.uint8)).save(folder / name)
    (tmp_path / "secret.png").write_bytes((folder / "a.png").read_bytes())
    with closing(LabelServer(LabelSession(folder, Segmenter.open()))) as served:
        yield served


def root_of(server: LabelServer) -> str:
    """The path with the token, without the slash at its end."""
    return urlsplit(server.url).path.rstrip("/")


def ask(server: LabelServer, path: str, method: str = "GET", body: Any = None, **headers: str) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=30)
    try:
        connection.request(method, path, body, {"Content-Type": "application/json"} | headers)
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def test_only_the_link_with_its_token_opens_anything(server: LabelServer, tmp_path: Path) -> None:
    prefix = root_of(server)
    status, page = ask(server, f"{prefix}/")
    assert status == 200
    assert b"<canvas" in page
    assert b"http://" not in page.replace(b"http://www.w3.org", b"")
    for path in ("/", "/photos", "/x/photos", prefix, f"{prefix[:-1]}/photos", f"/%2e%2e{prefix}/photos"):
        assert ask(server, path)[0] == 404, path
    assert ask(server, f"{prefix}/photos")[0] == 200
    assert ask(server, f"{prefix}/photos", Host="evil.example")[0] == 421, "a name that was bent to this machine"
    with closing(LabelServer(LabelSession(tmp_path / "photos"))) as other:
        assert root_of(other) != prefix


@pytest.mark.parametrize(
    "path",
    [
        "photo/../../secret.png",
        "photo/..%2f..%2fsecret.png",
        "photo/%2e%2e/secret.png",
        "../secret.png",
        "photo/-1",
        "photo/2",
        "photo/0/a",
        "photo/a.png",
        "photo/99999999999999999999",
        "areas/٣",
        "page.html",
        "polygons.json",
    ],
)
def test_no_path_reaches_beyond_the_photos_by_number(server: LabelServer, path: str) -> None:
    assert ask(server, f"{root_of(server)}/{quote(path, safe='/%')}") == (404, b"not found\n")


def test_what_is_saved_comes_back(server: LabelServer, tmp_path: Path) -> None:
    prefix, body = root_of(server), json.dumps(SHAPES)
    status, kept = ask(server, f"{prefix}/areas/1", "PUT", body)
    assert status == 200
    assert json.loads(ask(server, f"{prefix}/areas/1")[1]) == json.loads(kept) == SHAPES["shapes"]
    assert ask(server, f"{prefix}/photo/1")[1].startswith(b"\xff\xd8")
    suggested = json.loads(ask(server, f"{prefix}/suggested/0")[1])
    assert "sky" in {shape["name"] for shape in suggested}
    photos = json.loads(ask(server, f"{prefix}/photos")[1])
    assert [photo["areas"] for photo in photos["photos"]] == [0, 1]
    assert sorted(path.name for path in (tmp_path / "photos").iterdir()) == [
        "a.png",
        "b.png",
        "b_labels.png",
        "polygons.json",
    ]


def test_requests_that_are_too_large_or_from_elsewhere_are_refused(server: LabelServer, tmp_path: Path) -> None:
    path, body = f"{root_of(server)}/areas/0", json.dumps(SHAPES)
    assert ask(server, path, "PUT", body, **{"Content-Length": str(MOST_BYTES + 1)})[0] == 413
    assert ask(server, path, "PUT", body, **{"Content-Length": "-5"})[0] == 411
    assert ask(server, path, "PUT", "{", **{"Content-Length": "1"})[0] == 400
    assert ask(server, path, "PUT", "[" * 100_000)[0] == 400
    assert ask(server, path, "PUT", body, Origin="http://evil.example")[0] == 403
    assert ask(server, path, "PUT", body, **{"Transfer-Encoding": "chunked", "Content-Length": "5"})[0] == 411
    assert ask(server, f"{root_of(server)}/photos", "PUT", body)[0] == 404
    assert ask(server, path, "POST", body)[0] == 404
    assert not (tmp_path / "photos/polygons.json").exists()
    assert ask(server, path, "PUT", body, Origin=f"http://127.0.0.1:{server.port}")[0] == 200


@pytest.mark.slow
def test_one_photo_is_labelled_in_a_real_browser(server: LabelServer, tmp_path: Path) -> None:
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install 'ltm[dev]'")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("needs a Chromium (Debian: apt install chromium)")
    wrong: list[str] = []
    with playwright.sync_playwright() as tools:
        browser = tools.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1200, "height": 800})
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
        page.goto(server.url)
        page.wait_for_selector("body[data-ready='0']")
        box = page.locator("#view").bounding_box()
        assert box is not None
        scale = min(box["width"] / WIDTH, box["height"] / HEIGHT) * 0.97
        left = box["x"] + (box["width"] - scale * WIDTH) / 2
        top = box["y"] + (box["height"] - scale * HEIGHT) / 2

        def place(u: float, v: float) -> tuple[float, float]:
            return left + scale * (u + 0.5), top + scale * (v + 0.5)

        # The sky as a polygon, closed by Enter; one corner too many is taken back.
        page.keyboard.press("1")
        for u, v in ((10, 10), (310, 10), (310, 80), (150, 190)):
            page.mouse.click(*place(u, v))
        page.keyboard.press("Backspace")
        page.mouse.click(*place(10, 80))
        page.keyboard.press("Enter")
        # Trees by brush; then something that is undone, and an erased dot.
        page.keyboard.press("4")
        page.keyboard.press("b")
        page.mouse.move(*place(60, 140))
        page.mouse.down()
        page.mouse.move(*place(250, 150), steps=12)
        page.mouse.up()
        page.mouse.move(*place(160, 40))
        page.mouse.down()
        page.mouse.up()
        page.keyboard.press("Control+z")
        page.keyboard.press("e")
        page.mouse.move(*place(100, 40))
        page.mouse.down()
        page.mouse.up()
        # Zoomed and dragged, and the next corners still lie where they are set.
        page.keyboard.press("f")
        page.keyboard.press("Control+s")
        page.wait_for_selector("#said:has-text('saved:')")
        page.keyboard.press("ArrowRight")
        page.wait_for_selector("body[data-ready='1']")
        page.click("#network")
        page.wait_for_selector("#said:has-text('areas of the network')")
        page.keyboard.press("ArrowLeft")  # saves what is left
        page.wait_for_selector("body[data-ready='0']")
        browser.close()
    assert not wrong
    areas = read_areas(tmp_path / "photos/polygons.json")
    (sky,) = (area for area in areas if area.image == "a.png" and area.kind == "sky")
    np.testing.assert_allclose(sky.polygon, [(10, 10), (310, 10), (310, 80), (10, 80)], atol=1.0)
    with Image.open(tmp_path / "photos/a_labels.png") as png:
        labels = np.asarray(png)
    assert labels.shape == (HEIGHT, WIDTH)
    assert labels[20, 200] == labels[70, 300] == 0
    assert labels[140, 60] == labels[145, 155] == labels[150, 250] == 3
    assert labels[40, 160] == 0, "undone"
    assert labels[40, 100] == 255, "erased"
    assert labels[190, 20] == labels[5, 5] == 255
    with Image.open(tmp_path / "photos/b_labels.png") as png:
        assert (np.asarray(png)[:80] == 0).mean() > 0.9
