"""The network: an EfficientNet-Lite0 encoder, one or two light feature pyramids, a head for classes, one for depth."""

import copy
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval

from ltm_lab.training.config import NetworkConfig
from ltm_lab.training.encoder import TAPS, Lite0Encoder, convolution
from ltm_lab.training.scene_branch import SceneBranch

SIDES: Final = ("s2", "s1")
"""Decoder maps of 1/4 and 1/8 of the photo's size that may add to the class logits."""


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


class PyramidStep(nn.Module):  # type: ignore[misc]  # torch is not typed for us
    """Enlarges the coarse map by two, adds the encoder's map of that size, filters."""

    def __init__(self, coarse: int, skip: int, outputs: int) -> None:
        super().__init__()
        self.reduce = convolution(coarse, outputs, relu=True)
        self.skip = convolution(skip, outputs, relu=True)
        self.filter = nn.Sequential(
            convolution(outputs, outputs, 5, groups=outputs, relu=True), convolution(outputs, outputs, relu=True)
        )

    def forward(self, coarse: Tensor, skip: Tensor) -> Tensor:
        large = functional.interpolate(self.reduce(coarse), scale_factor=2.0, mode="bilinear", align_corners=False)
        joined: Tensor = self.filter(large + self.skip(skip))
        return joined


class Pyramid(nn.Module):  # type: ignore[misc]  # torch is not typed for us
    """From the encoder's maps to one of a quarter of the photo's size, (N, width, H/4, W/4)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        _, *middle, coarse = TAPS.values()
        self.reduce = convolution(coarse, width, relu=True)
        self.context = StripContext(width)
        self.steps = nn.ModuleList(PyramidStep(width, skip, width) for skip in reversed(middle))

    def quarter(self, maps: list[Tensor]) -> Tensor:
        """The map of a quarter of the photo's size, of the encoder's maps of that size and less."""
        return self.eighth_and_quarter(maps)[1]

    def eighth_and_quarter(self, maps: list[Tensor]) -> tuple[Tensor, Tensor]:
        """That map, after the one of half its size that it is made of."""
        *middle, coarse = maps
        x: Tensor = self.context(self.reduce(coarse))
        *first, last = zip(self.steps, reversed(middle), strict=True)
        for step, skip in first:
            x = step(x, skip)
        step, skip = last
        return x, step(x, skip)


class LandscapeNetwork(Pyramid):
    """Photo (N, 3, H, W), ImageNet-normalised -> class logits (N, classes, H/2, W/2) and log inverse depth
    (N, 1, H/4, W/4), both to be interpolated to the photo; H and W multiples of 32.

    The depth head answers in logarithms, so that a slope at 5 km is told from one at 6 km as surely as a bush at 5 m
    from one at 6 m; its scale is free: photos of unknown focal length do not give it. With `config.own_depth` it reads
    a pyramid of its own, so that depth may be taught without a label that changes. The pyramid of the classes is the
    network's own parts, by whose names exported files hold their weights. With `config.side` the maps SIDES add to the
    logits, too; with `config.scene` so does a second, small network (`SceneBranch`).
    """

    def __init__(self, classes: int, config: NetworkConfig) -> None:
        wide, narrow = config.width, config.width // 2
        super().__init__(wide)
        self.encoder = Lite0Encoder(config.fixed)
        self.last = PyramidStep(wide, next(iter(TAPS.values())), narrow)
        self.classes = nn.Conv2d(narrow, classes, 1)
        self.side = (
            nn.ModuleDict({name: nn.Conv2d(wide, classes, 1, bias=False) for name in SIDES}) if config.side else None
        )
        for side in () if self.side is None else self.side.values():
            nn.init.zeros_(side.weight)
        self.scene = SceneBranch(classes) if config.scene else None
        self.own = Pyramid(wide) if config.own_depth else None
        self.depth = nn.Sequential(
            convolution(wide, wide, 3, groups=wide, relu=True), convolution(wide, narrow, relu=True)
        )
        self.inverse = nn.Conv2d(narrow, 1, 1)

    def forward(self, photo: Tensor) -> tuple[Tensor, Tensor]:
        return self.heads(self.encoder(photo), photo)

    def heads(self, maps: list[Tensor], photo: Tensor) -> tuple[Tensor, Tensor]:
        """Logits and log inverse depth from the encoder's maps of a photo."""
        half, *rest = maps
        eighth, x = self.eighth_and_quarter(rest)
        y = x if self.own is None else self.own.quarter(rest)
        logits: Tensor = self.classes(self.last(x, half))
        more = [] if self.side is None else [self.side[name](m) for name, m in zip(SIDES, (x, eighth), strict=True)]
        for scores in more if self.scene is None else [*more, self.scene(photo)]:
            logits = logits + functional.interpolate(scores, logits.shape[2:], mode="bilinear", align_corners=False)
        return logits, self.inverse(self.depth(y))


class Deployed(nn.Module):  # type: ignore[misc]  # torch is not typed for us
    """The network as it is exported: outputs `logits` and `inverse_depth` (N, 1, H/4, W/4), positive, of free scale."""

    def __init__(self, network: LandscapeNetwork) -> None:
        super().__init__()
        self.network = for_inference(network)

    def forward(self, photo: Tensor) -> tuple[Tensor, Tensor]:
        logits, log_inverse = self.network(photo)
        return logits, torch.exp(log_inverse)


def for_inference(network: LandscapeNetwork) -> LandscapeNetwork:
    """A copy in evaluation mode whose batch normalisations are folded into the convolutions before them."""
    network = copy.deepcopy(network).eval()
    for module in network.modules():
        if not isinstance(module, nn.Sequential) or len(module) < 2:
            continue
        if isinstance(module[0], nn.Conv2d) and isinstance(module[1], nn.BatchNorm2d):
            module[0] = fuse_conv_bn_eval(module[0], module[1])
            module[1] = nn.Identity()
    return network
