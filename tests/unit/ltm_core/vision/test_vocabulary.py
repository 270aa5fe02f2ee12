import hashlib
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from scenes.networks import write_manifest

from ltm_core.base.errors import ModelError
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.prompts import prompted
from ltm_core.vision.segmenter import Segmenter
from ltm_core.vision.vocabulary import labels_of_classes

WORDS = ("dry grass", "chaparral", "oak", "road", "sky")
DIMENSIONS, SCALE = 6, 9.0
WIDTH, HEIGHT = 40, 24


def _write_embedder(folder: Path, **changes: object) -> Path:
    """A random 1x1 convolution from colours to embeddings, and random embeddings of words, of any length."""
    rng = np.random.default_rng(4)
    weight = rng.normal(0.0, 1.0, (DIMENSIONS, 3, 1, 1)).astype(np.float32)
    node = helper.make_node("Conv", ["image", "w"], ["dense"])
    graph = helper.make_graph(
        [node],
        "embedder",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, HEIGHT, WIDTH])],
        [helper.make_tensor_value_info("dense", TensorProto.FLOAT, [1, DIMENSIONS, HEIGHT, WIDTH])],
        [numpy_helper.from_array(weight, "w")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    (folder / "embedder.onnx").write_bytes(model.SerializeToString())
    embeddings = rng.normal(0.0, 3.0, (len(WORDS), DIMENSIONS))
    np.savez(folder / "words.npz", names=np.array(WORDS), embeddings=embeddings)
    content = {
        "name": "embedder",
        "file": "embedder.onnx",
        "sha256": hashlib.sha256((folder / "embedder.onnx").read_bytes()).hexdigest(),
        "input": {"width": WIDTH, "height": HEIGHT, "layout": "NCHW", "dtype": "float32", "scale": 1 / 255.0,
                  "mean": [0.5, 0.5, 0.5]},
        "output": {"kind": "embeddings"},
        "text": {"file": "words.npz", "dimensions": DIMENSIONS, "scale": SCALE},
        "mapping": {"dry grass": "grass", "chaparral": "shrub", "oak": "tree", "road": "bare", "sky": "sky"},
        "licence": "Apache-2.0",
        "card": "random, for tests",
    }  # fmt: skip
    return write_manifest(folder / "embedder.yaml", {**content, **changes})


def _expected(folder: Path, photo: np.ndarray, words: tuple[str, ...]) -> np.ndarray:
    """Softmax of scaled cosines, straight from the definition, (K, h, w)."""
    model = onnx.load(folder / "embedder.onnx")
    weight = numpy_helper.to_array(model.graph.initializer[0])[:, :, 0, 0].astype(np.float64)
    pixels = (photo / 255.0 - 0.5) @ weight.T
    text = np.load(folder / "words.npz")["embeddings"][[WORDS.index(word) for word in words]]
    cosine = (pixels @ text.T) / (np.linalg.norm(pixels, axis=-1)[..., None] * np.linalg.norm(text, axis=-1))
    weights = np.exp(SCALE * cosine)
    return np.moveaxis(weights / weights.sum(axis=-1, keepdims=True), -1, 0)


def test_pixels_take_the_word_whose_embedding_is_nearest(tmp_path: Path) -> None:
    segmenter = Segmenter.open(_write_embedder(tmp_path))
    photo = np.random.default_rng(1).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    expected = _expected(tmp_path, photo, WORDS)
    found = segmenter.class_probabilities(photo)
    assert tuple(found) == WORDS
    np.testing.assert_allclose(np.stack(list(found.values())), expected, atol=1e-5)
    result = segmenter.segment(photo)
    order = np.array([1, 2, 3, 4, 0], np.uint8)  # grass, shrub, tree, bare, sky
    np.testing.assert_array_equal(result.labels, order[expected.argmax(axis=0)])


def test_only_the_queried_words_compete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    manifest = NetworkManifest.load(_write_embedder(tmp_path))
    labels = LabelSet(("oak", "dry grass"), ((0, 90, 0), (200, 200, 0)), (True, True))
    segmenter = Segmenter(prompted(manifest, {}, labels), labels=labels)
    photo = np.random.default_rng(2).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    expected = _expected(tmp_path, photo, ("oak", "dry grass"))
    result = segmenter.segment(photo)
    np.testing.assert_array_equal(result.labels, expected.argmax(axis=0))
    np.testing.assert_allclose(result.confidence, expected.max(axis=0) * 255, atol=0.6)
    with pytest.raises(ModelError, match="chapparal"):
        prompted(manifest, {"oak": ("chapparal",)}, labels)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"text": {"file": "words.npz", "dimensions": 5}}, r"shape \(5, 6\); expected \(K, 5\)"),
        ({"text": {"file": "none.npz", "dimensions": DIMENSIONS}}, r"no file none\.npz; searched"),
        ({"text": {"file": "embedder.onnx", "dimensions": DIMENSIONS}}, r"expected an \.npz with names"),
        ({"mapping": {"pine": "tree"}}, r"mapping names pine, not among the words"),
        ({"output": {"kind": "logits"}}, r"text belongs to output kind embeddings"),
        ({"classes": ["oak"]}, r"words of the text file are the classes"),
    ],
)
def test_a_text_network_that_does_not_fit_is_refused(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        Segmenter.open(_write_embedder(tmp_path, **changes))


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("palm, palm tree", "tree"),  # ADE20K
        ("plant, flora, plant life", "shrub"),
        ("earth, ground", "bare"),
        ("canopy", None),
        ("mountain, mount", None),
        ("tree-merged", "tree"),  # COCO
        ("sky-other-merged", "sky"),
        ("plant-other", "shrub"),
        ("wood", None),
        ("nature--water", "water"),  # Mapillary Vistas
        ("construction--flat--road", "bare"),
        ("nature--vegetation", None),
        ("Grassland", "grass"),
        ("LABEL_3", None),
    ],
)
def test_the_label_of_a_networks_class_is_that_of_its_first_known_word(name: str, label: str | None) -> None:
    assert labels_of_classes([name]) == ({} if label is None else {name: label})
