"""A small network of text and images with the inputs and outputs of LSeg, trained on the labels of the demo.

Its features are random ones of colours at three scales; the last layer, by ridge regression, turns them into the
embedding of the word for what a pixel shows. The text encoder knows some words for each label.
"""

from pathlib import Path

import cv2
import numpy as np
import onnx
import onnxruntime as ort
from onnx import TensorProto, helper, numpy_helper

from ltm_core.site.site_io import load_site
from ltm_core.vision.onnx_file import NetworkFile
from ltm_ros.recordings.frame_stream import PARTS, FrameStream
from scenes.networks import write_manifest

DEMO = Path(__file__).parents[2] / "bags" / "demo"
WIDTH, HEIGHT = 240, 135
DIMENSIONS, FEATURES = 12, 160
WORDS = {
    "sky": 0, "cloud": 0, "grass": 1, "meadow": 1, "straw": 1, "shrub": 2, "chaparral": 2, "tree": 3, "conifer": 3,
    "bare": 4, "road": 4, "water": 5, "built": 6, "house": 6, "downed": 7, "trees": 3,
}  # fmt: skip


def demo_frames(count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return photos (H, W, 3) and true labels (h, w) of the first frames of the demo."""
    parts = {name: PARTS[name] for name in ("photo", "truth_labels")}
    stream = FrameStream(DEMO / "recording", load_site(DEMO / "site.yaml"), parts, ["tower_north", "tower_east"])
    found = []
    for frame in stream.frames(["photo", "truth_labels"]):
        found.append((frame.take("photo"), frame.take("truth_labels")))
        if len(found) == count:
            return found
    raise AssertionError(f"the demo has {len(found)} frames")


def word_vectors() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(8)
    meanings = np.linalg.qr(rng.normal(size=(DIMENSIONS, DIMENSIONS)))[0]
    return {word: meanings[label] + 0.03 * rng.normal(size=DIMENSIONS) for word, label in WORDS.items()}


def write_worded_network(folder: Path, trained_on: list[tuple[np.ndarray, np.ndarray]]) -> Path:
    """Write `worded.onnx`, `text_model.onnx` and `tokenizer.json`; gives the manifest's path."""
    vectors = word_vectors()
    last = np.zeros((FEATURES, DIMENSIONS))
    path = folder / "worded.onnx"
    _write_network(path, last)
    session = ort.InferenceSession(str(path))
    square, product = np.eye(FEATURES) * 3.0, np.zeros((FEATURES, DIMENSIONS))
    names = list(WORDS)
    meaning = np.stack([vectors[names[list(WORDS.values()).index(label)]] for label in range(7)])
    for photo, labels in trained_on:
        tensor = cv2.resize(photo, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).transpose(2, 0, 1)[None] / 255.0
        features = session.run(["features"], {"image": tensor.astype(np.float32)})[0][0].reshape(FEATURES, -1)
        true = cv2.resize(labels, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST).ravel()
        known = np.flatnonzero(true < 7)
        true = true[known]
        used = features[:, known] * (1e3 / np.maximum(np.bincount(true, minlength=7), 200)[true])  # labels weigh alike
        square += used @ features[:, known].T
        product += used @ meaning[true]
    _write_network(path, np.linalg.solve(square, product))
    _write_text_encoder(folder, vectors)
    content = {
        "name": "worded", "file": "worded.onnx", "sha256": NetworkFile.read(path).digest,
        "input": {"width": WIDTH, "height": HEIGHT, "layout": "NCHW", "dtype": "float32", "scale": 1 / 255.0},
        "output": {"kind": "embeddings", "name": "pixels"},
        "text": {"dimensions": DIMENSIONS, "scale": 14.3},
        "prompts": {"tokenizer": "tokenizer.json", "encoder": "text_model.onnx"},
        "licence": "Apache-2.0", "card": "of a test",
    }  # fmt: skip
    return write_manifest(folder / "worded.yaml", content)


def _write_network(path: Path, last: np.ndarray) -> None:
    rng = np.random.default_rng(2)
    nodes, planes = [], ["image", "row"]
    for side in (3, 11, 31):
        half = side // 2
        nodes.append(helper.make_node("AveragePool", ["image"], [f"mean{side}"], kernel_shape=[side, side],
                                      pads=[half] * 4))  # fmt: skip
        nodes.append(helper.make_node("Sub", ["image", f"mean{side}"], [f"beyond{side}"]))
        nodes.append(helper.make_node("Abs", [f"beyond{side}"], [f"contrast{side}"]))
        planes += [f"mean{side}", f"contrast{side}"]
    nodes.append(helper.make_node("Concat", planes, ["planes"], axis=1))
    hidden = rng.normal(size=(FEATURES, 22, 1, 1)).astype(np.float32) * 2.0
    constants = {
        "row": np.linspace(0, 1, HEIGHT, dtype=np.float32)[None, None, :, None].repeat(WIDTH, axis=3),
        "hidden": hidden, "shift": rng.uniform(-1.5, 1.5, FEATURES).astype(np.float32),
        "last": last.T.astype(np.float32)[..., None, None],
    }  # fmt: skip
    nodes.append(helper.make_node("Conv", ["planes", "hidden", "shift"], ["mixed"]))
    nodes.append(helper.make_node("Relu", ["mixed"], ["features"]))
    nodes.append(helper.make_node("Conv", ["features", "last"], ["pixels"]))
    outputs = [("pixels", DIMENSIONS), ("features", FEATURES)]
    _save(path, nodes, {"image": (TensorProto.FLOAT, [1, 3, HEIGHT, WIDTH])},
          {name: [1, size, HEIGHT, WIDTH] for name, size in outputs}, constants)  # fmt: skip


def _write_text_encoder(folder: Path, vectors: dict[str, np.ndarray]) -> None:
    from tokenizers import Tokenizer, models, pre_tokenizers

    ids = {"[PAD]": 0, "[UNK]": 1} | {word: place + 2 for place, word in enumerate(vectors)}
    tokenizer = Tokenizer(models.WordLevel(ids, unk_token="[UNK]"))
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    tokenizer.save(str(folder / "tokenizer.json"))
    table = np.stack([np.zeros(DIMENSIONS), np.full(DIMENSIONS, 0.01), *vectors.values()])
    nodes = [
        helper.make_node("Gather", ["table", "input_ids"], ["tokens"]),
        helper.make_node("ReduceSum", ["tokens", "axis"], ["text_embeds"], keepdims=0),
    ]
    constants = {"table": table.astype(np.float32), "axis": np.array([1], np.int64)}
    inputs = {"input_ids": (TensorProto.INT64, ["n", 5])}
    _save(folder / "text_model.onnx", nodes, inputs, {"text_embeds": ["n", DIMENSIONS]}, constants)


def _save(path: Path, nodes: list, inputs: dict, outputs: dict, constants: dict[str, np.ndarray]) -> None:
    graph = helper.make_graph(
        nodes,
        "worded",
        [helper.make_tensor_value_info(name, kind, shape) for name, (kind, shape) in inputs.items()],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in outputs.items()],
        [numpy_helper.from_array(np.ascontiguousarray(value), name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.save(model, path)
