"""Rebuilds a PyTorch network from the ONNX file that `ltm train` wrote, to adapt it or to train it further."""

from __future__ import annotations

import copy

import numpy as np
import onnx
import torch
from onnx import numpy_helper

from ltm_core.base.errors import ModelError
from ltm_core.vision.labels import Label
from ltm_core.vision.manifest import NetworkManifest
from ltm_lab.training.config import NetworkConfig
from ltm_lab.training.landscape_network import LandscapeNetwork, for_inference
from ltm_lab.training.structure_cue import StructureCue

_PREFIX = "network."  # of the weights' names in an exported file: see landscape.Deployed


def load_exported(manifest: NetworkManifest, fixed: int = 0) -> LandscapeNetwork:
    """The network of a file that `ltm train` wrote, with its batch normalisations folded in.

    `fixed`: blocks of its encoder that will not learn. Raises ModelError for a file of another architecture.
    """
    path = manifest.model_file()
    weights = {
        tensor.name.removesuffix("_half").removeprefix(_PREFIX): torch.from_numpy(
            numpy_helper.to_array(tensor).astype(np.float32)
        )
        for tensor in onnx.load(path).graph.initializer
        if tensor.name.startswith(_PREFIX)
    }
    try:
        bias, width = weights["classes.bias"], weights["reduce.0.weight"].shape[0]
        config = NetworkConfig(width=width, pretrained=False, fixed=fixed).with_parts_of(weights)
        network = for_inference(LandscapeNetwork(len(bias), config))
        network.load_state_dict(weights)
    except (KeyError, RuntimeError) as reason:
        raise ModelError(
            f"{path}: is not a network of `ltm train` ({str(reason).splitlines()[0]}); only such a one can learn on"
        ) from reason
    return network


def blended(first: LandscapeNetwork, second: LandscapeNetwork, share: float) -> LandscapeNetwork:
    """The network whose weights are (1 - share) of the first's and share of the second's, both from exported files.

    Raises ModelError for networks of two shapes.
    """
    result = copy.deepcopy(first)
    weights, others = result.state_dict(), second.state_dict()
    if {name: value.shape for name, value in weights.items()} != {name: v.shape for name, v in others.items()}:
        raise ModelError("networks of different shapes have no mean; blend a network with one that went on from it")
    result.load_state_dict({name: torch.lerp(value, others[name], share) for name, value in weights.items()})
    return result


def with_cue(network: LandscapeNetwork, cue: StructureCue) -> LandscapeNetwork:
    """A copy of a network in its exported form whose coarser maps say more of what is built, by so much."""
    wide = 2 * network.classes.in_channels
    config = NetworkConfig(width=wide, pretrained=False, fixed=16, own_depth=network.own is not None, side=True)
    result: LandscapeNetwork = for_inference(LandscapeNetwork(network.classes.out_channels, config))
    result.load_state_dict(result.state_dict() | network.state_dict())
    assert result.side is not None  # nosec B101 # by the configuration
    with torch.no_grad():
        for name, weights in cue.weights.items():
            result.side[name].weight[Label.BUILT, :, 0, 0] += torch.from_numpy(weights).float()
        result.classes.bias[Label.BUILT] += cue.bias
    return result
