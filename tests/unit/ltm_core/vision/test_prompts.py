from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scenes.worded_network import demo_frames, write_worded_network

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.fuel.label_errors import labels_digest
from ltm_core.vision.install_io import install, source_of
from ltm_core.vision.labels import UNLABELLED, Label, LabelSet
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.prompts import prompted
from ltm_core.vision.recognition import recognise
from ltm_core.vision.segmenter import Segmenter

pytest.importorskip("tokenizers")

LABELS = LabelSet.load()
OTHERS = {"sky": ("sky",), "tree": ("conifer",), "bare": ("road",)}
RIGHT = {**OTHERS, "grass": ("meadow", "straw"), "shrub": ("chaparral",)}
SWAPPED = {**OTHERS, "grass": ("chaparral",), "shrub": ("meadow", "straw")}
CLIPSEG = Path(__file__).parents[5] / "shared" / "models" / "signatures" / "clipseg" / "clipseg.onnx"


@pytest.fixture(scope="module")
def frames() -> list[tuple[np.ndarray, np.ndarray]]:
    return demo_frames(4)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory, frames: list[tuple[np.ndarray, np.ndarray]]) -> Path:
    return write_worded_network(tmp_path_factory.mktemp("worded"), frames[:3])


@pytest.fixture(autouse=True)
def own_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))


def accuracy(found: np.ndarray, truth: np.ndarray) -> float:
    rows, cols = (np.linspace(0, n - 1, m).round().astype(int) for n, m in zip(found.shape, truth.shape, strict=True))
    seen = found[np.ix_(rows, cols)]
    return float((seen == truth)[truth < 7].mean())


def test_prompts_of_a_site_decide_the_labels_of_a_held_out_image(
    trained: Path, frames: list[tuple[np.ndarray, np.ndarray]]
) -> None:
    photo, truth = frames[3]
    manifest = NetworkManifest.find(trained)
    right, swapped = (prompted(manifest, prompts, LABELS) for prompts in (RIGHT, SWAPPED))
    labels = {m: Segmenter(one).segment(photo).labels for m, one in (("right", right), ("swapped", swapped))}
    assert accuracy(labels["right"], truth) > 0.8
    assert accuracy(labels["swapped"], truth) < 0.55
    exchanged = np.array([0, 2, 1, 3, 4, 5, 6])
    np.testing.assert_array_equal(labels["swapped"], exchanged[labels["right"]])
    assert labels_digest(right) != labels_digest(swapped), "each vocabulary is measured for itself"
    # A negative prompt takes its pixels from all labels.
    without = {**RIGHT, "shrub": (), "other": ("chaparral",)}
    unlabelled = Segmenter(prompted(manifest, without, LABELS)).segment(photo).labels == UNLABELLED
    np.testing.assert_array_equal(unlabelled, labels["right"] == Label.SHRUB)


def test_a_folder_with_text_encoder_is_added_by_one_command(
    trained: Path, frames: list[tuple[np.ndarray, np.ndarray]]
) -> None:
    normalise, scale = {"normalise": "unit"}, {"text": {"scale": 14.3}}
    with source_of(str(trained.parent)) as source:
        added = install(recognise(source, {**normalise, **scale}), source)
    assert added.prompts is not None
    assert {(added.folder / p).is_file() for p in (added.prompts.tokenizer, added.prompts.encoder)} == {True}
    photo, truth = frames[3]
    assert accuracy(Segmenter(prompted(added, RIGHT, LABELS)).segment(photo).labels, truth) > 0.8
    assert accuracy(Segmenter(added).segment(photo).labels, truth) > 0.8, "the names of the labels are its prompts"


def test_a_network_that_takes_token_ids_runs_once_for_each_prompt(trained: Path, tmp_path: Path) -> None:
    folder = tmp_path / "clipseg"
    folder.mkdir()
    for name, content in (("model.onnx", CLIPSEG), ("tokenizer.json", trained.with_name("tokenizer.json"))):
        (folder / name).write_bytes(content.read_bytes())
    with source_of(str(folder)) as source:
        manifest = recognise(source, {"normalise": "imagenet"}, name="clipseg")
    assert manifest.classes == LABELS.names
    made = prompted(manifest, {"grass": ("meadow", "dry straw"), "tree": ("conifer",)}, LABELS)
    ids = made.input.constants["input_ids"]
    assert [len(row) for row in ids] == [2, 2, 2]
    assert made.input.constants["attention_mask"] == [[1, 0], [1, 1], [1, 0]]
    assert made.mapping == {"meadow": "grass", "dry straw": "grass", "conifer": "tree"}
    assert made.output.offsets == pytest.approx({"meadow": -np.log(2), "dry straw": -np.log(2)})
    photo = np.random.default_rng(1).integers(0, 255, (60, 90, 3), dtype=np.uint8)
    assert set(np.unique(Segmenter(made).segment(photo).labels)) <= {Label.GRASS, Label.TREE}


@pytest.mark.parametrize(
    ("prompts", "place"),
    [
        ({"gras": ("meadow",)}, "gras"),
        ({"grass": ("meadow", "meadow")}, "meadow"),
        ({"grass": (" ",)}, "' '"),
        ({"grass": ("x" * 201,)}, "200"),
        ({"grass": ("meadow",), "other": ("grass",)}, "grass"),
    ],
)
def test_invalid_vocabularies(trained: Path, prompts: dict[str, Any], place: str) -> None:
    with pytest.raises(ConfigError, match=place):
        prompted(NetworkManifest.find(trained), prompts, LABELS)


def test_networks_and_files_that_cannot_take_prompts(trained: Path, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="landscape_v5"):
        prompted(NetworkManifest.find("landscape_v5"), RIGHT, LABELS)
    content = yaml.safe_load(trained.read_text())
    for name, changed in (("tokenizer", trained), ("encoder", trained.with_name("worded.onnx"))):
        files = {key: str(trained.parent / file) for key, file in content["prompts"].items()} | {name: str(changed)}
        path = tmp_path / "broken.yaml"
        path.write_text(yaml.safe_dump(content | {"file": str(trained.with_name("worded.onnx")), "prompts": files}))
        with pytest.raises(ModelError, match=changed.name):
            prompted(NetworkManifest.find(path), RIGHT, LABELS)
