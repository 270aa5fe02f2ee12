"""A small encoder-decoder for CPU: inverted residuals to stride 32, strip context, U-shaped decoder to stride 2."""

import copy

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval

from ltm_core.vision.train.config import NetworkConfig


def _conv(inputs: int, outputs: int, size: int = 1, stride: int = 1, groups: int = 1, dilation: int = 1) -> nn.Module:
    padding = dilation * (size // 2)
    layer = nn.Conv2d(inputs, outputs, size, stride, padding, dilation, groups, bias=False)
    return nn.Sequential(layer, nn.BatchNorm2d(outputs))


def _conv_relu(
    inputs: int, outputs: int, size: int = 1, stride: int = 1, groups: int = 1, dilation: int = 1
) -> nn.Module:
    return nn.Sequential(_conv(inputs, outputs, size, stride, groups, dilation), nn.ReLU())


class InvertedResidual(nn.Module):  # type: ignore[misc]  # torch is not typed for us
    """Expand, filter each channel, project; with a shortcut where the shape stays (Sandler et al. 2018)."""

    def __init__(self, inputs: int, outputs: int, stride: int, expansion: int, dilation: int = 1) -> None:
        super().__init__()
        wide = inputs * expansion
        self.shortcut = stride == 1 and inputs == outputs
        self.body = nn.Sequential(
            _conv_relu(inputs, wide),
            _conv_relu(wide, wide, 3, stride, groups=wide, dilation=dilation),
            _conv(wide, outputs),
        )

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = self.body(x)
        return x + y if self.shortcut else y


class StripContext(nn.Module):  # type: ignore[misc]  # torch is not typed for us
    """Adds what the whole picture, each row and each column hold: rows tell ground from sky, the rest the scene.

    Its convolutions carry biases, no batch normalisation: over the few means of a small batch that would be noise.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.whole = nn.Conv2d(channels, channels, 1)
        self.rows = nn.Conv2d(channels, channels, 1)
        self.columns = nn.Conv2d(channels, channels, 1)
        self.join = nn.Conv2d(channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        context = self.whole(x.mean((2, 3), keepdim=True))
        context = context + self.rows(x.mean(3, keepdim=True)) + self.columns(x.mean(2, keepdim=True))
        return functional.relu(x + self.join(functional.relu(context)))


class DecoderStep(nn.Module):  # type: ignore[misc]  # torch is not typed for us
    """Enlarges the coarse map by two, joins the encoder's map of that size, filters."""

    def __init__(self, coarse: int, skip: int, outputs: int) -> None:
        super().__init__()
        self.reduce = _conv_relu(coarse, outputs)
        self.skip = _conv_relu(skip, outputs)
        self.filter = nn.Sequential(_conv_relu(outputs, outputs, 3, groups=outputs), _conv_relu(outputs, outputs))

    def forward(self, coarse: Tensor, skip: Tensor) -> Tensor:
        large = functional.interpolate(self.reduce(coarse), scale_factor=2.0, mode="bilinear", align_corners=False)
        joined: Tensor = self.filter(large + self.skip(skip))
        return joined


class SpineNetwork(nn.Module):  # type: ignore[misc]  # torch is not typed for us
    """Photo (N, 3, H, W) normalised float -> class logits (N, classes, H/2, W/2); H and W multiples of 32.

    A fourth channel, the height in the picture (-1 top, 1 bottom), is added inside.
    """

    def __init__(self, classes: int, config: NetworkConfig) -> None:
        super().__init__()
        widths, repeats = config.widths, config.repeats
        self.stem = nn.Sequential(
            _conv_relu(4, widths[0], 3, stride=2),
            _conv_relu(widths[0], widths[0], 3, groups=widths[0]),
            _conv_relu(widths[0], widths[0]),
        )
        self.stages = nn.ModuleList()
        for inputs, outputs, count in zip(widths[:-1], widths[1:], repeats, strict=True):
            blocks: list[nn.Module] = [InvertedResidual(inputs, outputs, 2, config.expansion)]
            for index in range(1, count):
                blocks.append(InvertedResidual(outputs, outputs, 1, config.expansion, dilation=1 + index % 2))
            self.stages.append(nn.Sequential(*blocks))
        self.context = StripContext(widths[-1])
        wide, narrow = config.decoder, max(16, config.decoder // 2)
        chain = (widths[-1], wide, wide, wide, narrow)
        skips = reversed(widths[:-1])
        self.decoder = nn.ModuleList(DecoderStep(*sizes) for sizes in zip(chain[:-1], skips, chain[1:], strict=True))
        self.head = nn.Conv2d(narrow, classes, 1)

    def forward(self, photo: Tensor) -> Tensor:
        count, _, height, width = photo.shape
        # through NumPy, so that an exported graph holds these rows as constants
        rows = torch.from_numpy(np.linspace(-1.0, 1.0, height, dtype=np.float32))
        x = torch.cat([photo, rows.view(1, 1, height, 1).expand(count, 1, height, width)], dim=1)
        maps = [self.stem(x)]
        for stage in self.stages:
            maps.append(stage(maps[-1]))
        x = self.context(maps.pop())
        for step in self.decoder:
            x = step(x, maps.pop())
        logits: Tensor = self.head(x)
        return logits


def for_inference(network: SpineNetwork) -> SpineNetwork:
    """A copy in evaluation mode whose batch normalisations are folded into the convolutions before them."""
    network = copy.deepcopy(network).eval()
    for module in network.modules():
        if isinstance(module, nn.Sequential) and len(module) == 2 and isinstance(module[1], nn.BatchNorm2d):
            convolution = module[0]
            if isinstance(convolution, nn.Conv2d):
                module[0] = fuse_conv_bn_eval(convolution, module[1])
                module[1] = nn.Identity()
    return network
