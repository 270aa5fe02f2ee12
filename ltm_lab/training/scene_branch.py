"""The scene branch: MOSAIC, a small network of everyday scenes, whose evidence is added to the class scores.

MLPerf Mobile published it (R4, Apache-2.0) with weights that had learnt 31 classes of ADE20K. `odds` are the measured
ratios of how often each of its 32 outputs occurs on each of our classes; two of its maps correct the result.
"""

from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

SIZE: Final = (256, 416)
_BLOCKS: Final = (
    # expanded channels, kernel, stride, dilation, outputs
    (96, 3, 2, 1, 32),
    (64, 3, 1, 1, 32),
    (160, 5, 2, 1, 64),
    (192, 3, 1, 1, 64),
    (128, 3, 1, 1, 64),
    (192, 3, 1, 1, 64),
    (384, 5, 2, 1, 128),
    (384, 3, 1, 1, 128),
    (384, 3, 1, 1, 128),
    (384, 3, 1, 1, 128),
    (768, 3, 1, 1, 160),
    (640, 3, 1, 1, 160),
    (960, 3, 1, 1, 192),
    (384, 5, 1, 2, 96),
    (384, 5, 1, 2, 96),
    (384, 5, 1, 2, 96),
)
_QUARTER, _EIGHTH = 1, 5  # blocks whose expanded maps the decoder reads
_POOLS: Final = ((8, 13), (4, 6), (2, 3))  # of the map of a sixteenth, 16 x 26
_OWN: Final = 32  # classes of MOSAIC, the first of them "other"
_LEAST: Final = 1e-3  # odds of a class for which there is no evidence
_MEAN, _STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of the photo that comes in


def _same(inputs: int, outputs: int, kernel: int = 1, stride: int = 1, dilation: int = 1, groups: int = 1) -> nn.Module:
    """Return a convolution that keeps the size, but for the stride; odd padding goes below and right."""
    total = (kernel - 1) * dilation + 1 - stride if stride > 1 else (kernel - 1) * dilation
    before = total // 2
    if before * 2 == total:
        return nn.Conv2d(inputs, outputs, kernel, stride, before, dilation, groups)
    pad = nn.ZeroPad2d((before, total - before, before, total - before))
    return nn.Sequential(pad, nn.Conv2d(inputs, outputs, kernel, stride, 0, dilation, groups))


def _enlarged(x: Tensor, size: tuple[int, int]) -> Tensor:
    """Return a map enlarged to a multiple of its size by linear interpolation; its top left pixel stays in place."""
    rows, columns = size
    padded = functional.pad(x, (0, 1, 0, 1), mode="replicate")
    large = functional.interpolate(padded, (rows + 1, columns + 1), mode="bilinear", align_corners=True)
    return large[:, :, :rows, :columns]


class _Block(nn.Module):  # type: ignore[misc]  # torch is not typed for us
    def __init__(self, inputs: int, expanded: int, kernel: int, stride: int, dilation: int, outputs: int) -> None:
        super().__init__()
        self.expand = _same(inputs, expanded)
        self.filter = _same(expanded, expanded, kernel, stride, dilation, expanded)
        self.project = _same(expanded, outputs)
        self.residual = stride == 1 and inputs == outputs

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return the block's map and its expanded one."""
        wide = functional.relu(self.filter(functional.relu(self.expand(x))))
        narrow = self.project(wide)
        return (narrow + x if self.residual else narrow), wide


class _Around(nn.Module):  # type: ignore[misc]  # torch is not typed for us
    """What surrounds a cell: half of the channels filtered by 3 x 3, half by 5 x 5, of a map of means."""

    def __init__(self, channels: int, outputs: int) -> None:
        super().__init__()
        half = channels // 2
        self.parts = nn.ModuleList(
            nn.Sequential(_same(half, half, kernel, groups=half), nn.ReLU(), _same(half, outputs // 2), nn.ReLU())
            for kernel in (3, 5)
        )

    def forward(self, x: Tensor) -> Tensor:
        return torch.cat([part(half) for part, half in zip(self.parts, x.chunk(2, 1), strict=True)], 1)


class SceneBranch(nn.Module):  # type: ignore[misc]  # torch is not typed for us
    """Photo (N, 3, H, W), ImageNet-normalised, of any size -> scores (N, classes, 64, 104)."""

    def __init__(self, classes: int) -> None:
        super().__init__()
        self.stem = _same(3, 32, 3, 2)
        inputs = (32, *(block[-1] for block in _BLOCKS))
        self.blocks = nn.ModuleList(_Block(n, *block) for n, block in zip(inputs, _BLOCKS, strict=False))
        self.top = _same(inputs[-1], 448)
        self.around = nn.ModuleList(_Around(448, 128) for _ in _POOLS)
        self.join = _same(448 + 3 * 128, 128)
        self.eighth = _same(128 + _BLOCKS[_EIGHTH][0], 64)
        self.smooth = _same(64, 64, 3, groups=64)
        self.own = _same(64, _OWN)
        self.quarter = _same(_BLOCKS[_QUARTER][0], _OWN)
        self.odds = nn.Conv2d(_OWN, classes, 1, bias=False).requires_grad_(False)
        nn.init.ones_(self.odds.weight)
        self.correction = nn.Conv2d(64 + _OWN, classes, 1)
        self.share = nn.Parameter(torch.ones(1))
        # From the photo's scale to MOSAIC's, (byte - 128) / 127.5.
        for name, values in {"scale": 2 * torch.tensor(_STD), "shift": 2 * torch.tensor(_MEAN) - 128 / 127.5}.items():
            self.register_buffer(name, values.view(1, 3, 1, 1), persistent=False)

    def forward(self, photo: Tensor) -> Tensor:
        small = functional.interpolate(photo, SIZE, mode="bilinear", align_corners=False)
        x = functional.relu(self.stem(small * self.scale + self.shift))
        wides = []
        for block in self.blocks:
            x, wide = block(x)
            wides.append(wide)
        x = functional.relu(self.top(x))
        rows, columns = SIZE[0] // 16, SIZE[1] // 16
        around = [
            _enlarged(part(functional.avg_pool2d(x, pool)), (rows, columns))
            for part, pool in zip(self.around, _POOLS, strict=True)
        ]
        x = functional.relu(self.join(torch.cat([*around, x], 1)))
        x = torch.cat([_enlarged(x, (2 * rows, 2 * columns)), wides[_EIGHTH]], 1)
        x = functional.relu(self.smooth(functional.relu(self.eighth(x))))
        finest = (4 * rows, 4 * columns)
        own = _enlarged(functional.relu(self.own(x)), finest) + functional.relu(self.quarter(wides[_QUARTER]))
        evidence = torch.log(self.odds(torch.softmax(own, 1)) + _LEAST)
        scores: Tensor = self.share * (evidence + self.correction(torch.cat([_enlarged(x, finest), own], 1)))
        return scores
