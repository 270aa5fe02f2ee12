"""Readers of networks, arrays and depth maps."""

import hashlib
import io
from pathlib import Path

import numpy as np
import yaml
from scenes.networks import HEIGHT, WIDTH, write_classifier

from fuzz.target import Target
from ltm_core.base.errors import ConfigError
from ltm_core.storage.config_io import load_arrays
from ltm_core.vision.segmenter import Segmenter


def _network(folder: Path) -> list[bytes]:
    write_classifier(folder)
    return [(folder / "colors.onnx").read_bytes()]


def _read_network(folder: Path) -> None:
    """The manifest states the spoiled file's checksum, as one that was made to harm would."""
    manifest = yaml.safe_load((folder / "colors.yaml").read_text())
    manifest["sha256"] = hashlib.sha256((folder / "colors.onnx").read_bytes()).hexdigest()
    (folder / "colors.yaml").write_text(yaml.safe_dump(manifest))
    Segmenter.open(folder / "colors.yaml").segment(np.zeros((HEIGHT, WIDTH, 3), np.uint8))


def _npz(folder: Path) -> list[bytes]:
    files = []
    for save in (np.savez, np.savez_compressed):
        file = io.BytesIO()
        save(file, names=np.array(["a", "bc"]), embeddings=np.asfortranarray(np.ones((2, 3), np.float32)))
        files.append(file.getvalue())
    return files


def _read_npz(folder: Path) -> None:
    load_arrays(folder / "a.npz", ("names", "embeddings"), 1 << 20, ConfigError)


ARRAY_FILES = (
    Target("network", "colors.onnx", _network, _read_network),
    Target("npz", "a.npz", _npz, _read_npz),
)
