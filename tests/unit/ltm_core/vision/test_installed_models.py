"""`ltm models`: a trial with a picture, words instead of classes, and adding a model by its manifest and checksum."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import pytest
from scenes.networks import changed, write_classifier
from typer.testing import CliRunner

from ltm_core.base.errors import ModelError
from ltm_core.vision.install_io import add_model
from ltm_core.vision.manifest import NetworkManifest
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


def ltm(*arguments: str) -> str:
    result = CliRunner().invoke(main.cli, ["models", *arguments], env={"COLUMNS": "200"})
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return re.sub(r"\s+", " ", result.output)


def test_an_added_model_is_found_by_its_name(tmp_path: Path, data_folder: Path) -> None:
    text = ltm("add", str(_renamed(tmp_path)), "--out", str(tmp_path / "out"))
    assert "added mine to" in text
    assert sorted(path.name for path in data_folder.iterdir()) == ["colors.onnx", "mine.yaml"]
    assert Segmenter.open("mine").model_path == data_folder / "colors.onnx"
    assert " mine " in ltm("list")


def test_nothing_is_fetched_unless_asked_and_the_checksum_decides(tmp_path: Path, data_folder: Path) -> None:
    path = _renamed(tmp_path)
    (tmp_path / "nets" / "colors.onnx").rename(tmp_path / "elsewhere.onnx")
    url = (tmp_path / "elsewhere.onnx").as_uri()
    changed(path, url=url)
    with pytest.raises(ModelError, match=r"file://.* Add --fetch"):
        add_model(path, fetch=False)
    received: list[int] = []
    assert add_model(path, fetch=True, progress=received.append).model_file() == data_folder / "colors.onnx"
    assert received[-1] == (tmp_path / "elsewhere.onnx").stat().st_size
    (data_folder / "colors.onnx").unlink()
    with (tmp_path / "elsewhere.onnx").open("ab") as file:
        file.write(b"x")
    with pytest.raises(ModelError, match=r"has sha256 [0-9a-f]{64}, expected [0-9a-f]{64}"):
        add_model(path, fetch=True)
    assert not (data_folder / "colors.onnx").exists()
    assert not list(data_folder.glob("*.part"))


def test_a_url_of_another_kind_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"url"):
        NetworkManifest.load(changed(write_classifier(tmp_path), url="ftp://host/net.onnx"))


def test_the_name_of_a_shipped_model_cannot_be_taken(tmp_path: Path) -> None:
    path = changed(write_classifier(tmp_path), name="mosaic_r4_ade20k31")
    with pytest.raises(ModelError, match=r"ships with the project"):
        add_model(path, fetch=False)


def test_a_check_leaves_a_picture_of_the_words_looked_for(tmp_path: Path) -> None:
    path = write_classifier(tmp_path)
    text = ltm("check", str(path), "--classes", "meadow, house", "--out", str(tmp_path / "out"))
    assert "'meadow' is read as grass: colors has no finer word" in text
    picture = cv2.imread(str(tmp_path / "out" / "trial_scene_colors.jpg"))
    assert picture.shape[1] == 640
    assert picture.std() > 10
