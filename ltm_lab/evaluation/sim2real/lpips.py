"""LPIPS: a perceptual distance between two pictures, from the features of a trained network.

Zhang et al. 2018, "The unreasonable effectiveness of deep features as a perceptual metric"; version 0.1, with the
learned linear weights. The network runs in torch on the weights that `perceptual_io` reads.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float32Array, UInt8Array

Backbone = Literal["alexnet", "vgg16"]

_SHIFT = (-0.030, -0.088, -0.188)
_SCALE = (0.458, 0.448, 0.450)
_TINY = 1e-10


@dataclass(frozen=True)
class _Conv:
    """A convolution; `pool`: size and stride of the max pooling before it; `tap`: whether LPIPS compares after it."""

    stride: int
    padding: int
    pool: tuple[int, int] | None
    tap: bool


_ALEXNET = (
    _Conv(4, 2, None, True),
    _Conv(1, 2, (3, 2), True),
    _Conv(1, 1, (3, 2), True),
    _Conv(1, 1, None, True),
    _Conv(1, 1, None, True),
)
_VGG16 = tuple(
    _Conv(1, 1, (2, 2) if first and block else None, last)
    for block, count in enumerate((2, 2, 3, 3, 3))
    for first, last in ((i == 0, i == count - 1) for i in range(count))
)
_LAYERS: dict[Backbone, tuple[_Conv, ...]] = {"alexnet": _ALEXNET, "vgg16": _VGG16}
_SMALLEST: dict[Backbone, int] = {"alexnet": 31, "vgg16": 16}


@dataclass(frozen=True, eq=False)
class LpipsWeights:
    """`kernels`: (h, w, in, out) a convolution; `biases`: (out,); `linear`: (channels,) for each compared layer."""

    backbone: Backbone
    kernels: tuple[Float32Array, ...]
    biases: tuple[Float32Array, ...]
    linear: tuple[Float32Array, ...]

    @classmethod
    def from_tree(cls, backbone: Backbone, tree: Mapping[str, Any]) -> LpipsWeights:
        """From the nested mapping of Flax parameters. Raises KeyError where a layer is missing."""
        network = tree["AlexNet_0" if backbone == "alexnet" else "VGG16_0"]
        convs = [network[f"Conv_{i}"] for i in range(len(_LAYERS[backbone]))]
        taps = sum(layer.tap for layer in _LAYERS[backbone])
        linear = tuple(tree[f"NetLinLayer_{i}"]["Conv_0"]["kernel"][0, 0, :, 0] for i in range(taps))
        return cls(backbone, tuple(c["kernel"] for c in convs), tuple(c["bias"] for c in convs), linear)


class Lpips:
    """Distances between pictures of one size."""

    def __init__(self, weights: LpipsWeights) -> None:
        import torch

        self._backbone = weights.backbone
        self._kernels = [torch.from_numpy(k.transpose(3, 2, 0, 1).copy()) for k in weights.kernels]
        self._biases = [torch.from_numpy(np.array(b)) for b in weights.biases]
        self._linear = [torch.from_numpy(np.array(w)) for w in weights.linear]

    def distance(self, a: UInt8Array, b: UInt8Array) -> float:
        """LPIPS of two RGB pictures (H, W, 3) uint8. Raises ImageError on other shapes, or too few pixels."""
        if a.shape != b.shape or a.ndim != 3 or a.shape[2] != 3:
            raise ImageError(f"LPIPS compares two pictures (H, W, 3) of one size, got {a.shape} and {b.shape}")
        if min(a.shape[:2]) < _SMALLEST[self._backbone]:
            raise ImageError(f"LPIPS with {self._backbone} needs {_SMALLEST[self._backbone]} pixels a side: {a.shape}")
        return self.of_range(*(picture.astype(np.float32) / 127.5 - 1 for picture in (a, b)))

    def of_range(self, a: Float32Array, b: Float32Array) -> float:
        """LPIPS of two pictures (H, W, 3) with values in -1 .. 1."""
        import torch

        with torch.inference_mode():
            shift, scale = (torch.tensor(v).view(1, 3, 1, 1) for v in (_SHIFT, _SCALE))
            pictures = torch.from_numpy(np.stack([a, b]).transpose(0, 3, 1, 2).astype(np.float32))
            total = 0.0
            for weight, layer in zip(self._linear, self._taps((pictures - shift) / scale), strict=True):
                unit = layer / (layer.pow(2).sum(dim=1, keepdim=True).sqrt() + _TINY)
                difference = (unit[0] - unit[1]).pow(2)
                total += float((difference * weight.view(-1, 1, 1)).sum(dim=0).mean())
        return total

    def _taps(self, x: Any) -> list[Any]:
        import torch.nn.functional as functional

        taps = []
        for layer, kernel, bias in zip(_LAYERS[self._backbone], self._kernels, self._biases, strict=True):
            if layer.pool is not None:
                x = functional.max_pool2d(x, *layer.pool)
            x = functional.relu(functional.conv2d(x, kernel, bias, layer.stride, layer.padding))
            if layer.tap:
                taps.append(x)
        return taps
