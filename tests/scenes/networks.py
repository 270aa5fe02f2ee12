"""Small ONNX networks with known answers: a linear colour classifier, in every layout that a manifest can state."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import yaml
from onnx import TensorProto, helper, numpy_helper

WIDTH, HEIGHT = 48, 32
# The classes of the classifier, each the photo colour that it answers to.
COLORS = {"blue": (0, 0, 255), "red": (255, 0, 0), "lime": (0, 255, 0), "olive": (0, 200, 0), "white": (255, 255, 255)}
MAPPING = {"blue": "sky", "red": "built", "lime": "grass", "olive": "grass"}  # white is left out: unlabelled


def write_classifier(
    folder: Path,
    kind: str = "logits",
    layout: str = "NCHW",
    dtype: str = "float32",
    channels: str = "rgb",
    stride: int = 2,
    gain: float = 40.0,
    maps: bool = False,
    any_size: bool = False,
    **manifest_changes: Any,
) -> Path:
    """Write `colors.onnx` and its manifest; gives the manifest's path. `maps`: with the map `mean`, for heads to read.
    `any_size`: it takes photos of any size.

    Score of a class is -|rgb - colour|^2 plus a term that all share, of the photo averaged over `stride` pixels:
    linear, so one 1x1 convolution. Output is at 1/stride of the input.
    """
    colors = np.array(list(COLORS.values()), np.float32) / 255.0
    weight = (2.0 * gain * colors)[..., None, None]
    bias = -gain * (colors**2).sum(axis=1)
    if channels == "bgr":
        weight = weight[:, ::-1]
    nodes, last = [], "image"
    constants = [numpy_helper.from_array(np.ascontiguousarray(weight), "w"), numpy_helper.from_array(bias, "b")]
    if dtype == "uint8":
        constants.append(numpy_helper.from_array(np.float32(255.0), "byte"))
        nodes += [helper.make_node("Cast", [last], ["f"], to=TensorProto.FLOAT)]
        nodes += [helper.make_node("Div", ["f", "byte"], ["unit"])]
        last = "unit"
    if layout == "NHWC":
        nodes.append(helper.make_node("Transpose", [last], ["planes"], perm=[0, 3, 1, 2]))
        last = "planes"
    size = [stride, stride]
    nodes.append(helper.make_node("AveragePool", [last], ["mean"], kernel_shape=size, strides=size))
    nodes.append(helper.make_node("Conv", ["mean", "w", "b"], ["scores"]))
    last = "scores"
    rows, cols, count = HEIGHT // stride, WIDTH // stride, len(COLORS)
    shape = [1, count, rows, cols]
    if kind == "probabilities":
        nodes.append(helper.make_node("Softmax", [last], ["soft"], axis=1))
        last = "soft"
    if kind == "ids":
        nodes.append(helper.make_node("ArgMax", [last], ["ids"], axis=1, keepdims=0))
        last, shape = "ids", [1, rows, cols]
    elif layout == "NHWC":
        nodes.append(helper.make_node("Transpose", [last], ["last"], perm=[0, 2, 3, 1]))
        last, shape = "last", [1, rows, cols, count]
    element = TensorProto.UINT8 if dtype == "uint8" else TensorProto.FLOAT
    if any_size:
        rows = cols = None
        shape = [1, count, rows, cols]
    image_shape = (
        [1, 3, *(("height", "width") if any_size else (HEIGHT, WIDTH))] if layout == "NCHW" else [1, HEIGHT, WIDTH, 3]
    )
    graph = helper.make_graph(
        nodes,
        "colors",
        [helper.make_tensor_value_info("image", element, image_shape)],
        [
            helper.make_tensor_value_info(last, TensorProto.INT64 if kind == "ids" else TensorProto.FLOAT, shape),
            *([helper.make_tensor_value_info("mean", TensorProto.FLOAT, [1, 3, rows, cols])] if maps else []),
        ],
        constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    (folder / "colors.onnx").write_bytes(model.SerializeToString())
    image = {"width": WIDTH, "height": HEIGHT, "layout": layout, "dtype": dtype, "channels": channels}
    if dtype == "float32":
        image["scale"] = 1.0 / 255.0
    manifest = {
        "name": "colors",
        "file": "colors.onnx",
        "sha256": hashlib.sha256((folder / "colors.onnx").read_bytes()).hexdigest(),
        "input": image,
        "output": {"kind": kind, "layout": layout},
        "classes": list(COLORS),
        "mapping": MAPPING,
        "licence": "Apache-2.0",
        "card": "a linear classifier of colours, for tests",
    }
    if maps:
        manifest["maps"] = {"mean": 3}
    return write_manifest(folder / "colors.yaml", {**manifest, **manifest_changes})


def write_swapping_head(path: Path, manifest: Path, **changes: Any) -> Path:
    """Write a head of the classifier with `maps` that calls red what is lime, and lime what is red."""
    network, red, lime = yaml.safe_load(manifest.read_text()), list(COLORS).index("red"), list(COLORS).index("lime")
    weights = np.zeros((len(COLORS), 3))
    weights[red], weights[lime] = (-200.0, 200.0, 0.0), (200.0, -200.0, 0.0)
    content = {
        "name": path.stem,
        "network": network["name"],
        "sha256": network["sha256"],
        "classes": network["classes"],
        "temperature": 1.0,
        "bias": [0.0] * len(COLORS),
        "maps": {"mean": weights.tolist()},
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    return write_manifest(path, {**content, **changes})


def write_manifest(path: Path, content: dict[str, Any]) -> Path:
    path.write_text(yaml.safe_dump(content))
    return path


def changed(path: Path, **changes: Any) -> Path:
    """The manifest at `path` with other values: `changed(p, input={"width": 3})` merges into that key's mapping."""
    content = yaml.safe_load(path.read_text())
    for key, value in changes.items():
        content[key] = {**content[key], **value} if isinstance(value, dict) and key != "mapping" else value
    return write_manifest(path, content)


def write_depth_network(
    folder: Path,
    kind: str = "relative_inverse",
    values: str = "green",
    two_heads: bool = False,
) -> Path:
    """Write `depth.onnx` and its manifest; gives the manifest's path.

    `values`: "green": the photo's green channel / 255 at full size; "nan"; "negative": green / 255 - 2. `two_heads`: a
    second output, `scores`, of five labels.
    """
    pick = np.array([0.0, 1.0, 0.0], np.float32).reshape(1, 3, 1, 1)
    factor, offset = {"green": (1.0, 0.0), "nan": (np.nan, 0.0), "negative": (1.0, -2.0)}[values]
    constants = [
        numpy_helper.from_array(pick * np.float32(factor), "pick"),
        numpy_helper.from_array(np.array([offset], np.float32), "offset"),
    ]
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, HEIGHT, WIDTH])
    nodes = [helper.make_node("Conv", ["image", "pick", "offset"], ["depth"])]
    outputs = [helper.make_tensor_value_info("depth", TensorProto.FLOAT, [1, 1, HEIGHT, WIDTH])]
    if two_heads:
        colors = np.array(list(COLORS.values()), np.float32)[..., None, None] / 255.0
        constants.append(numpy_helper.from_array(colors, "colors"))
        nodes.append(helper.make_node("Conv", ["image", "colors"], ["scores"]))
        outputs.insert(0, helper.make_tensor_value_info("scores", TensorProto.FLOAT, [1, len(COLORS), HEIGHT, WIDTH]))
    graph = helper.make_graph(nodes, "depth", [image], outputs, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    (folder / "depth.onnx").write_bytes(model.SerializeToString())
    content = {
        "name": "depth",
        "file": "depth.onnx",
        "sha256": hashlib.sha256((folder / "depth.onnx").read_bytes()).hexdigest(),
        "input": {"width": WIDTH, "height": HEIGHT, "layout": "NCHW", "dtype": "float32", "scale": 1.0 / 255.0},
        "output": {"kind": kind, "name": "depth"},
        "licence": "Apache-2.0",
        "card": "a colour channel as depth, for tests",
    }
    return write_manifest(folder / "depth.yaml", content)
