"""A trained network -> ONNX file and manifest, checked against what was trained."""

import hashlib
import warnings
from pathlib import Path

import numpy as np
import onnxruntime as ort
import torch
import yaml

from ltm_core.errors import ModelError
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.train.config import TrainingConfig
from ltm_core.vision.train.loop import MEAN, STD
from ltm_core.vision.train.network import SpineNetwork, for_inference

OPSET = 17
TOLERANCE = 1e-3  # of logits, ONNX Runtime against PyTorch


def export(network: SpineNetwork, config: TrainingConfig, labels: LabelSet, folder: Path) -> Path:
    """Write `<name>.onnx` and `<name>.yaml` into `folder`; gives the manifest's path.

    The file is run in ONNX Runtime on random photos and must give the network's own logits (ModelError otherwise).
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{config.name}.onnx"
    network = for_inference(network)
    example = torch.zeros(1, 3, config.height, config.width)
    with warnings.catch_warnings():
        # The tracing exporter needs no further package; its deprecation is known.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            (example,),
            file,
            opset_version=OPSET,
            dynamo=False,
            input_names=["image"],
            output_names=["logits"],
        )
    _compare(network, file, config)
    manifest = folder / f"{config.name}.yaml"
    manifest.write_text(_manifest(file, config, labels), encoding="utf-8")
    return manifest


def _compare(network: SpineNetwork, file: Path, config: TrainingConfig) -> None:
    session = ort.InferenceSession(file, providers=["CPUExecutionProvider"])
    rng = np.random.default_rng(config.seed)
    for _ in range(3):
        photo = rng.normal(0.0, 1.0, (1, 3, config.height, config.width)).astype(np.float32)
        with torch.inference_mode():
            expected = network(torch.from_numpy(photo)).numpy()
        (found,) = session.run(None, {"image": photo})
        error = float(np.abs(found - expected).max())
        if not error <= TOLERANCE:
            raise ModelError(f"{file}: logits differ from the trained network's by {error:.3g}, limit {TOLERANCE:g}")


def _manifest(file: Path, config: TrainingConfig, labels: LabelSet) -> str:
    content = {
        "name": config.name,
        "file": file.name,
        "sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
        "licence": config.licence,
        "card": f"{config.name}.md",
        "source": "trained by `ltm train` on frames of this project's simulator",
        "input": {
            "width": config.width,
            "height": config.height,
            "layout": "NCHW",
            "dtype": "float32",
            "scale": 1.0 / 255.0,
            "mean": list(MEAN),
            "std": list(STD),
        },
        "output": {"name": "logits", "kind": "logits", "layout": "NCHW"},
        "classes": list(labels.names),
        "mapping": {name: name for name in labels.names},
    }
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110)
