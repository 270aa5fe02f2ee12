"""Names the decoder maps of an exported network and makes them outputs of its graph, for label heads to read."""

from typing import Any, Final

from onnx import TensorProto, helper, shape_inference

from ltm_core.base.errors import ModelError

_READERS: Final = {
    "last": "network.classes.weight",
    "s2": "network.last.reduce.0.weight",
    "s1": "network.steps.2.reduce.0.weight",
}
"""Map -> the weights of the convolution that reads it (`landscape_network.LandscapeNetwork`)."""


def with_decoder_maps(model: Any) -> tuple[Any, dict[str, int]]:
    """Return the ONNX model with the outputs `last`, `s2`, `s1` (1/2, 1/4, 1/8 of the input's size) and their channels.

    Label heads read these decoder maps. A run that does not request an output does not compute it, so cameras without
    a label head pay nothing. Raises ModelError for a file of another architecture.
    """
    shapes = {v.name: v.type.tensor_type.shape for v in shape_inference.infer_shapes(model).graph.value_info}
    channels = {}
    present = {output.name for output in model.graph.output}
    for name, weights in _READERS.items():
        reader = next((node for node in model.graph.node if node.op_type == "Conv" and node.input[1] == weights), None)
        if reader is None:
            raise ModelError(f"the network has no convolution of {weights}; it is not one of `ltm train`")
        tensor = reader.input[0]
        if name not in present:
            dims = [d.dim_value or None for d in shapes[tensor].dim]  # sides are free in a file of any size
            _rename(model.graph, tensor, name)
            model.graph.output.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, dims))
        output = next(o for o in model.graph.output if o.name == name)
        channels[name] = int(output.type.tensor_type.shape.dim[1].dim_value)
    return model, channels


def _rename(graph: Any, old: str, new: str) -> None:
    for node in graph.node:
        for names in (node.input, node.output):
            for place, name in enumerate(names):
                if name == old:
                    names[place] = new
