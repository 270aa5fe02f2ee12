"""Tiny ONNX networks with the inputs and outputs of public exports, and the files that hubs put beside them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

IMAGENET = {"image_mean": [0.485, 0.456, 0.406], "image_std": [0.229, 0.224, 0.225], "do_normalize": True}
HALF = {"image_mean": [0.5, 0.5, 0.5], "image_std": [0.5, 0.5, 0.5], "do_normalize": True}
ADE = {
    "0": "wall",
    "1": "building, edifice",
    "2": "sky",
    "3": "tree",
    "4": "grass",
    "5": "earth, ground",
    "6": "canopy",
}


class Graph:
    """An ONNX graph under construction; `image` is an input with `channels` of features at its `features`."""

    def __init__(
        self, image: str, shape: list[Any], channels: int, stride: int, element: int = TensorProto.FLOAT
    ) -> None:
        self.rng = np.random.default_rng(3)
        self.nodes: list[Any] = []
        self.constants: list[Any] = []
        self.inputs = [helper.make_tensor_value_info(image, element, shape)]
        self.outputs: list[Any] = []
        planes = image
        if len(shape) == 5:
            planes = self.add("Squeeze", [image, self.constant(np.array([1], np.int64))])
        weight = self.rng.normal(0, 1, (channels, 3, stride, stride)).astype(np.float32) / stride
        half = element == TensorProto.FLOAT16
        kernel = self.constant(weight.astype(np.float16) if half else weight)
        self.features = self.add("Conv", [planes, kernel], strides=[stride, stride])

    def constant(self, value: Any) -> str:
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(value), name))
        return name

    def add(self, operation: str, given: list[str], **attributes: Any) -> str:
        name = f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(operation, given, [name], **attributes))
        return name

    def takes(self, name: str, element: int, shape: list[Any]) -> str:
        self.inputs.append(helper.make_tensor_value_info(name, element, shape))
        return name

    def gives(self, name: str, source: str, shape: list[Any], element: int = TensorProto.FLOAT) -> None:
        self.nodes.append(helper.make_node("Identity", [source], [name]))
        self.outputs.append(helper.make_tensor_value_info(name, element, shape))

    def write(self, path: Path, external: bool = False) -> Path:
        graph = helper.make_graph(self.nodes, "export", self.inputs, self.outputs, self.constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        path.parent.mkdir(parents=True, exist_ok=True)
        if external:
            for tensor in model.graph.initializer:
                if tensor.data_type == TensorProto.FLOAT:
                    onnx.external_data_helper.set_external_data(tensor, location=f"{path.name}_data")
        onnx.save(model, str(path))
        return path


def hub(folder: Path, config: dict[str, Any] | None = None, preprocessor: dict[str, Any] | None = None) -> None:
    """Write the JSON files of a hub."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in (("config", config), ("preprocessor_config", preprocessor)):
        if content is not None:
            (folder / f"{name}.json").write_text(json.dumps(content))


def segformer(folder: Path) -> Path:
    hub(folder, {"model_type": "segformer", "id2label": ADE}, IMAGENET | {"size": {"height": 64, "width": 64}})
    graph = Graph("pixel_values", ["batch_size", 3, "height", "width"], len(ADE), 4)
    graph.gives("logits", graph.features, ["batch_size", len(ADE), "h", "w"])
    return graph.write(folder / "onnx" / "model.onnx")


def queries(
    folder: Path, kind: str, classes: int = 7, mask: bool = False, task: bool = False, side: Any = None
) -> Path:
    """Mask2Former, EoMT or OneFormer: masks of 5 queries at a quarter of the image's size."""
    sides = [side, side] if side else ["height", "width"]
    hub(folder, {"model_type": kind, "id2label": ADE}, IMAGENET | {"size": {"shortest_edge": 64, "longest_edge": 256}})
    graph = Graph("pixel_values", ["batch", 3, *sides], 5, 4)
    masks = graph.features
    if mask:
        given = graph.takes("pixel_mask", TensorProto.INT64, ["batch", *sides])
        share = graph.add("ReduceMean", [graph.add("Cast", [given], to=TensorProto.FLOAT)], keepdims=0)
        masks = graph.add("Mul", [masks, share])
    pooled = graph.add("GlobalAveragePool", [graph.features])
    logits = graph.add(
        "MatMul", [graph.add("Squeeze", [pooled, graph.constant(np.array([3]))]),
                   graph.constant(graph.rng.normal(0, 3, (1, classes + 1)).astype(np.float32))]
    )  # fmt: skip
    if task:
        tokens = graph.add("Cast", [graph.takes("task_inputs", TensorProto.INT64, ["batch", 77])], to=TensorProto.FLOAT)
        logits = graph.add("Add", [logits, graph.add("ReduceMean", [tokens])])
        scale = graph.add("Div", [graph.add("ReduceMean", [tokens]), graph.constant(np.float32(2000.0))])
        masks = graph.add("Mul", [masks, scale])
    graph.gives("class_queries_logits", logits, ["batch", 5, classes + 1])
    graph.gives("masks_queries_logits", masks, ["batch", 5, "h", "w"])
    return graph.write(folder / "model.onnx")


def skips(folder: Path) -> Path:
    """A network with a skip connection over a stride of 16 that fails at other multiples, without JSON files."""
    graph = Graph("input", [1, 3, "height", "width"], len(ADE), 1)
    small = graph.add("MaxPool", [graph.features], kernel_shape=[16, 16], strides=[16, 16])
    scales = graph.constant(np.array([1, 1, 16, 16], np.float32))
    large = graph.add("Resize", [small, "", scales], mode="nearest")
    graph.gives(
        "output", graph.add("Softmax", [graph.add("Add", [large, graph.features])], axis=1), [1, len(ADE), "h", "w"]
    )
    return graph.write(folder / "net.onnx")


def zoedepth(folder: Path) -> Path:
    hub(folder, {"model_type": "zoedepth"}, HALF | {"size": {"height": 96, "width": 128}, "ensure_multiple_of": 32})
    graph = Graph("pixel_values", ["b", 3, "height", "width"], 1, 1)
    depth = graph.add("Add", [graph.add("Abs", [graph.features]), graph.constant(np.float32(1.0))])
    graph.gives(
        "predicted_depth", graph.add("Squeeze", [depth, graph.constant(np.array([1]))]), ["b", "height", "width"]
    )
    pooled = graph.add("GlobalAveragePool", [graph.features])
    graph.gives("domain_logits", graph.add("Flatten", [pooled]), ["b", 1])
    return graph.write(folder / "model.onnx")


def depth_anything(folder: Path, metric: bool = False) -> Path:
    """Depth Anything V2, relative or metric; half precision, patches of 14 pixels."""
    hub(
        folder,
        {"model_type": "depth_anything", "depth_estimation_type": "metric" if metric else "relative"},
        IMAGENET | {"size": {"height": 70, "width": 70}, "keep_aspect_ratio": True, "ensure_multiple_of": 14},
    )
    graph = Graph("pixel_values", ["batch", 3, "height", "width"], 1, 1, TensorProto.FLOAT16)
    depth = graph.add("Add", [graph.add("Abs", [graph.features]), graph.constant(np.float16(1.0))])
    plane = graph.add("Squeeze", [depth, graph.constant(np.array([1]))])
    graph.gives("predicted_depth", plane, ["batch", "h", "w"], TensorProto.FLOAT16)
    return graph.write(folder / "model_fp16.onnx")


def depth_anything_3(folder: Path) -> Path:
    """One view of a sequence of images, weights outside the file."""
    graph = Graph("pixel_values", ["batch_size", "num_images", 3, "height", "width"], 1, 1)
    depth = graph.add("Add", [graph.add("Abs", [graph.features]), graph.constant(np.float32(1.0))])
    graph.gives("predicted_depth", depth, ["batch_size", "num_images", "height", "width"])
    pooled = graph.add("GlobalAveragePool", [graph.features])
    for name, shape in (("extrinsics", [1, 1, 3, 4]), ("intrinsics", [1, 1, 3, 3])):
        graph.gives(name, graph.add("Expand", [pooled, graph.constant(np.array(shape, np.int64))]), shape)
    return graph.write(folder / "onnx" / "model.onnx", external=True)


def tokens(folder: Path, leading: int, kind: str, dimensions: int = 6) -> Path:
    """A vision tower whose patches of 16 pixels are aligned with text: SigLIP (0 leading tokens), DINOv3 (5)."""
    hub(folder, {"model_type": kind}, HALF | {"size": {"height": 64, "width": 64}})
    graph = Graph("pixel_values", ["batch", 3, 64, 64], dimensions, 16)
    shape = graph.constant(np.array([0, dimensions, -1], np.int64))
    rows = graph.add("Transpose", [graph.add("Reshape", [graph.features, shape])], perm=[0, 2, 1])
    if leading:
        first = graph.constant(np.full((1, leading, dimensions), 9.0, np.float32))
        rows = graph.add("Concat", [first, rows], axis=1)
    graph.gives("last_hidden_state", rows, ["batch", 16 + leading, dimensions])
    words = np.random.default_rng(8).normal(0, 1, (3, dimensions)).astype(np.float32)
    np.savez(folder / "words.npz", names=np.array(["grass", "oak", "sky"]), embeddings=words)
    return graph.write(folder / "model.onnx")


def lseg(folder: Path) -> Path:
    """Dense embeddings at half the image's size."""
    folder.mkdir(parents=True, exist_ok=True)
    graph = Graph("image", [1, 3, 64, 64], 6, 2)
    graph.gives("features", graph.features, [1, 6, 32, 32])
    words = np.random.default_rng(8).normal(0, 1, (3, 6)).astype(np.float32)
    np.savez(folder / "words.npz", names=np.array(["grass", "oak", "sky"]), embeddings=words)
    return graph.write(folder / "lseg.onnx")


EXPORTS: dict[str, Callable[[Path], Path]] = {
    "segformer": segformer,
    "mask2former": lambda folder: queries(folder, "mask2former", mask=True),
    "eomt": lambda folder: queries(folder, "eomt", side=64),
    "oneformer": lambda folder: queries(folder, "oneformer", mask=True, task=True),
    "zoedepth": zoedepth,
    "depth_anything_v2": depth_anything,
    "depth_anything_v2_metric": lambda folder: depth_anything(folder, metric=True),
    "depth_anything_v3": depth_anything_3,
    "siglip": lambda folder: tokens(folder, 0, "siglip_vision_model"),
    "dinov3_text": lambda folder: tokens(folder, 5, "dinov3_vit"),
    "lseg": lseg,
}
