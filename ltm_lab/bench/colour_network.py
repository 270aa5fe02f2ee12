"""A network that classifies the colours of drawn images in one linear step, so that a month of them costs little.

The score of a class depends on the distance of a pixel's colour, averaged over two by two, from the colour of the
class. As with a real network, its errors follow light and haze.
"""

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

NETWORK = "colours.yaml"
_GAIN = 60.0
"""Factor from squared distances of colours, with channels from 0 to 1, to logits."""


def write_colour_network(
    folder: Path, colours: Mapping[str, tuple[int, int, int]], mapping: Mapping[str, str], size: tuple[int, int]
) -> None:
    """Write the network and its manifest (`NETWORK`) into a folder.

    Args:
        colours: 8-bit colour of each class.
        mapping: our label of each class.
        size: width and height of the images.
    """
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    shown = np.array(list(colours.values()), np.float32) / 255.0
    weight = np.ascontiguousarray((2 * _GAIN * shown)[..., None, None])
    constants = [numpy_helper.from_array(weight, "w"), numpy_helper.from_array(-_GAIN * (shown**2).sum(axis=1), "b")]
    width, height = size
    graph = helper.make_graph(
        [
            helper.make_node("AveragePool", ["image"], ["mean"], kernel_shape=[2, 2], strides=[2, 2]),
            helper.make_node("Conv", ["mean", "w", "b"], ["scores"]),
        ],
        "colours",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, height, width])],
        [helper.make_tensor_value_info("scores", TensorProto.FLOAT, [1, len(shown), height // 2, width // 2])],
        constants,
    )
    content = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(content)
    packed = content.SerializeToString()
    (folder / "colours.onnx").write_bytes(packed)
    manifest = {
        "name": "colours",
        "file": "colours.onnx",
        "sha256": hashlib.sha256(packed).hexdigest(),
        "input": {"width": width, "height": height, "layout": "NCHW", "dtype": "float32", "scale": 1 / 255},
        "output": {"kind": "logits", "layout": "NCHW", "withdraw": {"confidence": 0.5}},
        "classes": list(colours),
        "mapping": dict(mapping),
        "licence": "Apache-2.0",
        "card": "a linear classifier of drawn colours",
    }
    (folder / NETWORK).write_text(yaml.safe_dump(manifest), encoding="utf-8")
