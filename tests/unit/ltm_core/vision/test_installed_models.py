import hashlib
import re
import shutil
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scenes.networks import changed, write_classifier, write_depth_network
from scenes.public_exports import depth_anything, depth_anything_3, segformer
from typer.testing import CliRunner

from ltm_core.base.errors import ModelError
from ltm_core.depth.monocular import DepthNetwork
from ltm_core.geometry.camera import Camera
from ltm_core.vision import install_io
from ltm_core.vision.install_io import Recipe, RecipeFile, download
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.onnx_file import NetworkFile
from ltm_core.vision.onnx_model import OnnxModel
from ltm_core.vision.segmenter import Segmenter
from ltm_ros.cli import main


@pytest.fixture(autouse=True)
def data_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    return tmp_path / "data" / "ltm" / "models"


def _renamed(folder: Path) -> Path:
    """A manifest `mine.yaml` whose network lies in a folder of its own."""
    path = write_classifier(folder)
    (folder / "nets").mkdir()
    (folder / "colors.onnx").rename(folder / "nets" / "colors.onnx")
    return changed(path, name="mine", file="nets/colors.onnx").rename(folder / "mine.yaml")


def ltm(*arguments: str | Path) -> str:
    result = CliRunner().invoke(main.cli, ["models", *map(str, arguments)], env={"COLUMNS": "200"})
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return re.sub(r"\s+", " ", result.output)


def add(given: str | Path, *options: str) -> str:
    return ltm("add", given, "--out", Path(str(given)).parent / "out", *options)


def files(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_an_added_model_is_found_by_its_name(tmp_path: Path, data_folder: Path) -> None:
    text = ltm("add", _renamed(tmp_path), "--out", tmp_path / "out")
    assert "`model: mine`" in text
    assert files(data_folder) == ["mine.yaml", "mine/mine.onnx"]
    assert Segmenter.open("mine").manifest.model_file() == data_folder / "mine" / "mine.onnx"
    assert cv2.imread(str(tmp_path / "out" / "trial_scene_mine.jpg")).std() > 10
    assert " mine " in ltm("list")
    assert "`model: mine`" in ltm("add", tmp_path / "mine.yaml", "--out", tmp_path / "out")  # the same again


def test_networks_of_one_file_name_do_not_overwrite_each_other(tmp_path: Path, data_folder: Path) -> None:
    depth_anything_3(tmp_path / "first")
    depth_anything_3(tmp_path / "second")
    weights = tmp_path / "second" / "onnx" / "model.onnx_data"
    weights.write_bytes(bytes(len(weights.read_bytes())))
    for name in ("first", "second"):
        add(tmp_path / name)
    own = [(f"{name}.yaml", f"{name}/{name}.onnx", f"{name}/model.onnx_data") for name in ("first", "second")]
    assert files(data_folder) == sorted(sum(own, ()))
    photo, camera = np.full((70, 70, 3), 200, np.uint8), Camera.from_fov(70, 70, 50.0)
    first, second = (DepthNetwork.open(name).predict(photo, camera).values for name in ("first", "second"))
    assert first.max() > 1
    np.testing.assert_array_equal(second, 0.0)


def test_another_network_does_not_take_the_name_of_an_installed_one(tmp_path: Path, data_folder: Path) -> None:
    depth_anything(tmp_path / "a" / "net")
    depth_anything(tmp_path / "b" / "net", metric=True)
    file = tmp_path / "b" / "net" / "model_fp16.onnx"
    file.write_bytes(file.read_bytes() + b"\x72\x00")  # an empty `metadata_props`
    add(tmp_path / "a" / "net")
    before = (data_folder / "net.yaml").read_bytes()
    with pytest.raises(ModelError, match=r"net\.yaml.*--name"):
        add(tmp_path / "b" / "net")
    assert (data_folder / "net.yaml").read_bytes() == before
    assert "`depth_model: other`" in add(tmp_path / "b" / "net", "--name", "other")


def test_the_digest_covers_external_weights(tmp_path: Path) -> None:
    file = depth_anything_3(tmp_path / "net")
    found = NetworkFile.read(file)
    own, weights = (hashlib.sha256(path.read_bytes()).hexdigest() for path in (file, file.with_name("model.onnx_data")))
    assert found.weights == ("model.onnx_data",)
    assert found.digest == hashlib.sha256(f"{own} \n{weights} model.onnx_data\n".encode()).hexdigest()
    add(tmp_path / "net")
    installed = NetworkManifest.find("net")
    assert installed.sha256 == NetworkFile.read(installed.model_file()).digest == found.digest
    data = installed.model_file().with_name("model.onnx_data")
    data.write_bytes(data.read_bytes()[:-1] + b"\x01")
    with pytest.raises(ModelError, match=found.digest):
        OnnxModel(installed)
    data.unlink()
    with pytest.raises(ModelError, match=r"model\.onnx_data"):
        OnnxModel(installed)
    plain = write_classifier(tmp_path)
    assert NetworkFile.read(tmp_path / "colors.onnx").digest == NetworkManifest.load(plain).sha256


def test_external_weights_are_those_beside_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, data_folder: Path
) -> None:
    """Not those of the working directory, and through the links of a hub's cache."""
    file = depth_anything_3(tmp_path / "blobs")
    cache = tmp_path / "snapshots" / "net" / "onnx"
    cache.mkdir(parents=True)
    for name in ("model.onnx", "model.onnx_data"):
        (cache / name).symlink_to(file.with_name(name))
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "model.onnx_data").write_bytes(bytes(12))
    monkeypatch.chdir(elsewhere)
    add(tmp_path / "snapshots" / "net")
    photo, camera = np.full((70, 70, 3), 200, np.uint8), Camera.from_fov(70, 70, 50.0)
    assert DepthNetwork.open("net").predict(photo, camera).values.max() > 1
    assert not any(path.is_symlink() for path in data_folder.rglob("*"))


@pytest.mark.parametrize("location", ["../model.onnx_data", "/etc/hostname"])
def test_weights_outside_the_folder_are_rejected(tmp_path: Path, location: str) -> None:
    file = depth_anything_3(tmp_path / "net")
    file.write_bytes(file.read_bytes().replace(b"model.onnx_data", location.encode().ljust(15, b"x")[:15]))
    with pytest.raises(ModelError, match=re.escape(location[:13])):
        NetworkFile.read(file)


@pytest.mark.parametrize(
    "content", [b"", b"\xff" * 40, b"\x3a\xff\xff\xff\xff\x7f", b"<html>404</html>", b"\x3a\x02\x2a\x00"]
)
def test_a_file_that_is_no_network_is_rejected(tmp_path: Path, data_folder: Path, content: bytes) -> None:
    (tmp_path / "net.onnx").write_bytes(content)
    assert NetworkFile.read(tmp_path / "net.onnx").digest == hashlib.sha256(content).hexdigest()
    with pytest.raises(ModelError, match=r"net\.onnx"):
        add(tmp_path / "net.onnx")
    assert not data_folder.exists()


class _Hub(BaseHTTPRequestHandler):
    """A hub that redirects to its storage, with ranges; `folder`: its files, `cut`: bytes after which it hangs up."""

    folder = Path()
    cut = 0
    ranges: list[str | None] = []  # noqa: RUF012

    def do_GET(self) -> None:
        name = self.path.removeprefix("/storage")
        content = (self.folder / name.lstrip("/")).read_bytes()
        if not self.path.startswith("/storage"):
            self.send_response(302)
            self.send_header("location", f"/storage{self.path}")
            self.send_header("x-linked-etag", f'"{hashlib.sha256(content).hexdigest()}"')
            self.send_header("content-length", "0")
            self.end_headers()
            return
        wanted = self.headers.get("range")
        self.ranges.append(wanted)
        start = int(wanted.removeprefix("bytes=").rstrip("-")) if wanted else 0
        if start >= len(content):
            self.send_error(416)
            return
        self.send_response(206 if wanted else 200)
        self.send_header("content-length", str(len(content) - start))
        self.end_headers()
        self.wfile.write(content[start : self.cut or None])

    def log_message(self, *arguments: Any) -> None:
        """Print nothing."""


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    (tmp_path / "hub").mkdir()
    monkeypatch.setattr(_Hub, "folder", tmp_path / "hub")
    monkeypatch.setattr(_Hub, "ranges", [])
    server = HTTPServer(("127.0.0.1", 0), _Hub)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()
    thread.join()


def test_a_download_resumes_and_its_digest_decides(tmp_path: Path, hub: str, monkeypatch: pytest.MonkeyPatch) -> None:
    content = np.random.default_rng(1).bytes(300_000)
    (tmp_path / "hub" / "model.onnx").write_bytes(content)
    target, url = tmp_path / "got" / "model.onnx", f"{hub}/model.onnx"
    monkeypatch.setattr(_Hub, "cut", 100_000)
    with pytest.raises(ModelError, match=r"run the command again"):
        download(url, target, None)
    monkeypatch.setattr(_Hub, "cut", 0)
    received: list[int] = []
    download(url, target, None, received.append)
    assert target.read_bytes() == content
    assert _Hub.ranges[1] is not None
    assert received[-1] == len(content)
    target.unlink()
    with pytest.raises(ModelError, match=r"expected (ab){32}"):
        download(url, target, "ab" * 32)
    assert not list(target.parent.iterdir())
    part = target.with_name("model.onnx.part")
    part.write_bytes(content)  # all of it arrived, but its end was not seen
    download(url, target, None)
    assert target.read_bytes() == content
    part.write_bytes(b"x" * 5)  # the beginning of another file
    target.unlink()
    with pytest.raises(ModelError, match=hashlib.sha256(content).hexdigest()):
        download(url, target, None)
    assert not list(target.parent.iterdir())
    (tmp_path / "hub" / "model.onnx").unlink()
    with pytest.raises(ModelError, match=r"/missing"):
        download(f"{hub}/missing", target, None)


def test_a_recipe_is_added_by_its_name(
    tmp_path: Path, hub: str, monkeypatch: pytest.MonkeyPatch, data_folder: Path
) -> None:
    segformer(tmp_path / "hub")
    digests = dict.fromkeys(("onnx/model.onnx", "config.json", "preprocessor_config.json"))
    shipped = RecipeFile.load()
    recipe = Recipe(licence="MIT", page="https://example.org", url=hub, files=digests)
    monkeypatch.setattr(
        RecipeFile, "load", classmethod(lambda cls: shipped.model_copy(update={"recipes": {"seg-former": recipe}}))
    )
    assert "`model: seg_former`" in ltm("add", "seg-former", "--out", tmp_path / "out")
    assert files(data_folder) == ["seg_former.yaml", "seg_former/seg_former.onnx"]
    assert NetworkManifest.find("seg_former").licence == "MIT"
    assert "seg-former" in ltm("list")
    shutil.rmtree(tmp_path / "hub" / "onnx")
    (data_folder / "seg_former.yaml").unlink()
    with pytest.raises(ModelError, match=r"onnx/model\.onnx"):
        ltm("add", "seg-former", "--out", tmp_path / "out")


def test_every_recipe_has_a_licence_and_an_address_and_can_be_exported_or_downloaded() -> None:
    known = RecipeFile.load()
    for name, recipe in known.recipes.items():
        assert recipe.licence
        assert recipe.page.startswith("https://")
        assert bool(recipe.url) == any(file.endswith(".onnx") for file in recipe.files)
        assert recipe.manifest["normalise"] in known.normalisations
        if not recipe.url:
            with pytest.raises(ModelError, match=rf"{re.escape(recipe.page)}.*--like {name}"):
                ltm("add", name)
    with pytest.raises(ModelError, match=r"depth-anything-v2-small"):
        ltm("add", "depth-nothing")
    assert install_io.merged({"a": {"b": 1, "c": 2}}, {"a": {"b": 3}}) == {"a": {"b": 3, "c": 2}}


def test_the_depth_of_one_file_with_labels_and_depth_is_chosen_by_its_output(tmp_path: Path) -> None:
    write_depth_network(tmp_path, two_heads=True)
    add(tmp_path / "depth.onnx", "--set", "output.name=depth", "--set", "output.kind=metric", "--set", "normalise=unit")
    assert NetworkManifest.find("depth").output.name == "depth"
