"""Writes a trained network as an ONNX file with its manifests, checks the file, and reads such files for training."""

import hashlib
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort
import torch
import yaml
from onnx import TensorProto, helper, numpy_helper

from ltm_core.base.errors import ModelError
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.manifest import NetworkManifest, Withdrawal
from ltm_lab.training.config import NetworkConfig, TrainingConfig
from ltm_lab.training.decoder_maps import with_decoder_maps
from ltm_lab.training.landscape_network import Deployed, LandscapeNetwork, for_inference
from ltm_lab.training.loop import MEAN, STD

OPSET = 17
TOLERANCE = 0.02  # of logits and relative depth: ONNX Runtime with weights of half precision against PyTorch, median
_TENSORS = ("image", "logits", "inverse_depth")
_SMALL = 256  # elements: smaller constants stay as they are
_PREFIX = "network."  # of the names of weights in an exported file: see `landscape_network.Deployed`


def export(network: LandscapeNetwork, config: TrainingConfig, labels: LabelSet, folder: Path) -> Path:
    """Write `<name>.onnx`, `<name>.yaml` (classes) and `<name>_depth.yaml` into `folder`; gives the first manifest.

    Weights are stored in half precision and computed with in single: the file halves, no time is lost. The file is
    run in ONNX Runtime on random photos and must give the network's own answers (ModelError otherwise).
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{config.name}.onnx"
    deployed = Deployed(network)
    example = torch.zeros(1, 3, config.deploy_height, config.deploy_width)
    with warnings.catch_warnings():
        # The tracing exporter needs no further package; its deprecation is known.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            deployed,
            (example,),
            file,
            opset_version=OPSET,
            dynamo=False,
            input_names=_TENSORS[:1],
            output_names=_TENSORS[1:],
            # Sides may be any multiples of 32.
            dynamic_axes={name: {2: f"{name}_height", 3: f"{name}_width"} for name in _TENSORS},
        )
    model, maps = with_decoder_maps(halved(onnx.load(file)))
    onnx.save(model, file)
    _compare(deployed, file, config)
    manifest = folder / f"{config.name}.yaml"
    _write(manifest, _manifest(file, config, labels) | {"maps": maps})
    _write(folder / f"{config.name}_depth.yaml", _depth_manifest(file, config))
    return manifest


def load_exported(manifest: NetworkManifest, fixed: int = 0) -> LandscapeNetwork:
    """Read the network of a file that `export` wrote, to train it further; its batch normalisations are folded in.

    `fixed`: number of encoder blocks that are not trained. Raises ModelError for a file of another architecture.
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


def halved(model: Any) -> Any:
    """The ONNX model with its large float32 constants stored as float16 and cast back when it is loaded."""
    casts, kept = [], []
    for tensor in model.graph.initializer:
        values = numpy_helper.to_array(tensor)
        if values.dtype != np.float32 or values.size < _SMALL or float(np.abs(values).max()) > 6e4:
            kept.append(tensor)
            continue
        kept.append(numpy_helper.from_array(values.astype(np.float16), f"{tensor.name}_half"))
        casts.append(helper.make_node("Cast", [f"{tensor.name}_half"], [tensor.name], to=TensorProto.FLOAT))
    nodes = [*casts, *model.graph.node]
    del model.graph.initializer[:], model.graph.node[:]
    model.graph.initializer.extend(kept)
    model.graph.node.extend(nodes)
    onnx.checker.check_model(model)
    return model


def _compare(network: Deployed, file: Path, config: TrainingConfig) -> None:
    session = ort.InferenceSession(file, providers=["CPUExecutionProvider"])
    rng = np.random.default_rng(config.seed)
    for _ in range(3):
        photo = rng.normal(0.0, 1.0, (1, 3, config.deploy_height, config.deploy_width)).astype(np.float32)
        with torch.inference_mode():
            logits, inverse = (output.numpy() for output in network(torch.from_numpy(photo)))
        found = session.run(_TENSORS[1:], {"image": photo})
        error = max(
            float(np.median(np.abs(found[0] - logits))), float(np.median(np.abs(np.log(found[1]) - np.log(inverse))))
        )
        if not error <= TOLERANCE:
            raise ModelError(f"{file}: answers differ from the trained network's by {error:.3g}, limit {TOLERANCE:g}")


def _write(path: Path, content: dict[str, Any]) -> None:
    path.write_text(yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110), encoding="utf-8")


def _common(file: Path, config: TrainingConfig) -> dict[str, Any]:
    return {
        "file": file.name,
        "sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
        "licence": config.licence,
        "card": f"{config.name}.md",
        "source": "trained by `ltm-lab train run`",
        "input": {
            "width": config.deploy_width,
            "height": config.deploy_height,
            "layout": "NCHW",
            "dtype": "float32",
            "scale": 1.0 / 255.0,
            "mean": list(MEAN),
            "std": list(STD),
        },
    }


def _manifest(file: Path, config: TrainingConfig, labels: LabelSet) -> dict[str, Any]:
    return {
        "name": config.name,
        **_common(file, config),
        "output": {"name": "logits", "kind": "logits", "layout": "NCHW"}
        | ({"offsets": config.offsets} if config.offsets else {})
        | ({"redness": config.redness} if config.redness else {})
        | ({"withdraw": config.withdraw.model_dump()} if config.withdraw != Withdrawal() else {}),
        "classes": list(labels.names),
        "mapping": {name: name for name in labels.names},
        **({"heads_of": config.heads_of} if config.heads_of else {}),
    }


def _depth_manifest(file: Path, config: TrainingConfig) -> dict[str, Any]:
    return {
        "name": f"{config.name}_depth",
        **_common(file, config),
        "output": {"name": "inverse_depth", "kind": "relative_inverse", "layout": "NCHW"},
        **({"heads_of": f"{config.heads_of}_depth"} if config.heads_of else {}),
    }
