"""Gives a network of labels the depth of another one: one encoder then serves both, and a frame costs one run.

Encoder and labels stay what they are, to the bit. A pyramid for depth alone begins with the other network's weights,
whose encoder is an earlier state of this one's, and learns on photos to say what that one says (distillation: Hinton et
al. 2015), and on rendered frames what is true, too.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from ltm_core.base.errors import ModelError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.vision.labels import Label
from ltm_lab.training.adapt import sized
from ltm_lab.training.augment import augmented
from ltm_lab.training.config import AugmentConfig, NetworkConfig
from ltm_lab.training.labelled_frames import Frame
from ltm_lab.training.landscape_network import LandscapeNetwork, for_inference
from ltm_lab.training.loop import device, normalised

_HEAD = ("own.", "depth.", "inverse.")


class DepthPyramidConfig(StrictModel):
    """How the pyramid is taught. `windows`: changed copies of photos that it is taught on, drawn once, since what both
    encoders make of them stays the same; 1.4 MB each. `width`, `height`: of what photos are brought to; whole photos,
    as they are asked for later, since the context of rows and columns is a whole photo's."""

    windows: int = Field(default=2000, ge=1)
    steps: int = Field(default=3000, ge=1)
    batch: int = Field(default=8, ge=1)
    learning_rate: float = Field(default=1.5e-3, gt=0)
    average: float = Field(default=0.99, ge=0, lt=1)
    truth: float = Field(default=1.0, ge=0)  # weight of true depth, where a frame has it, beside the other network's
    seed: int = 0
    width: int = Field(default=640, ge=64, multiple_of=32)
    height: int = Field(default=352, ge=64, multiple_of=32)
    augment: AugmentConfig = AugmentConfig(new_sky=0.1, ground_tint=0.1, snow=0.03, haze=0.1)


class _Window(NamedTuple):
    """What the labels' encoder makes of a photo, its maps of a quarter of the photo's size and less (C, h, w) in half
    precision; what the other network says of depth, whether a pixel is land, and what is true (NaN: unknown), each
    (1, h, w) of a quarter; of depth the logarithm of its inverse."""

    maps: tuple[Tensor, ...]
    wanted: Tensor
    land: Tensor
    true: Tensor


def with_depth_of(
    labels: LandscapeNetwork,
    depth: LandscapeNetwork,
    frames: list[Frame],
    config: DepthPyramidConfig,
    report: Callable[[int, float], None],
) -> LandscapeNetwork:
    """The labels' network with the other's depth, both in their exported form.

    `frames`: photos, of whose labels (all UNKNOWN, where nobody gave any) only changes of their look make use; where
    their depth is more than an order, it is learnt, too. `report` gets how many windows and steps are done, and the
    loss (NaN before the first step). Raises ModelError without frames, and for networks of different shapes.
    """
    if not frames:
        raise ModelError("no photos to learn on")
    frames = [_sized(frame, config) for frame in frames]
    torch.manual_seed(config.seed)
    network = joined(labels, depth)
    network.to(device()).eval()
    teacher = depth.to(device()).eval()
    windows = []
    for k in range(config.windows):
        windows.append(_window(frames, network, teacher, config, np.random.default_rng([config.seed, k])))
        report(k + 1, math.nan)
    for name, parameter in network.named_parameters():
        parameter.requires_grad_(name.startswith(_HEAD))
    taught = [p for p in network.parameters() if p.requires_grad]
    means = [p.detach().clone() for p in taught]
    optimiser = torch.optim.AdamW(taught, lr=config.learning_rate, weight_decay=0.0)
    rng = np.random.default_rng([config.seed, config.windows])
    for step in range(1, config.steps + 1):
        for group in optimiser.param_groups:
            group["lr"] = config.learning_rate * 0.5 * (1.0 + np.cos(np.pi * step / config.steps))
        batch = [windows[i] for i in rng.integers(0, len(windows), config.batch)]
        maps = [torch.stack(of_tap).float().to(device()) for of_tap in zip(*(w.maps for w in batch), strict=True)]
        found = network.own_log_inverse(maps)
        wanted, land, true = (torch.stack([w[k] for w in batch]).to(device()) for k in (1, 2, 3))
        known = torch.isfinite(true)
        loss = land_depth_loss(found, wanted, land)
        loss = loss + config.truth * land_depth_loss(found, torch.where(known, true, 0.0), known)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        with torch.no_grad():
            for mean, value in zip(means, taught, strict=True):
                mean.lerp_(value, 1.0 - min(config.average, step / (step + 10)))
        report(config.windows + step, float(loss.detach()))
    with torch.no_grad():
        for mean, value in zip(means, taught, strict=True):
            value.copy_(mean)
    depth.cpu()
    network.cpu()
    return network


def joined(labels: LandscapeNetwork, depth: LandscapeNetwork) -> LandscapeNetwork:
    """The labels' network with the other's pyramid and head for depth, as they are; one that has a pyramid already,
    as it is. Raises ModelError where the two have different shapes."""
    state = copy.deepcopy(labels.state_dict())
    if labels.own is None:
        for name, value in depth.state_dict().items():
            part = name.split(".", 1)[0]
            if part in ("depth", "inverse", "own"):
                state[name] = value.clone()
            elif depth.own is None and part in ("reduce", "context", "steps"):
                state[f"own.{name}"] = value.clone()
    width = labels.inverse.in_channels * 2
    config = NetworkConfig(width=width, pretrained=False, fixed=16).with_parts_of(state)
    network: LandscapeNetwork = for_inference(LandscapeNetwork(labels.classes.out_channels, config))
    try:
        network.load_state_dict(state)
    except RuntimeError as reason:
        raise ModelError(
            f"networks of different shapes share no encoder ({str(reason).splitlines()[1].strip()})"
        ) from reason
    return network


def differences(
    network: LandscapeNetwork, depth: LandscapeNetwork, photos: list[UInt8Array], config: DepthPyramidConfig
) -> Float64Array:
    """(N,) mean |log ratio| of the network's inverse depth to the other's: see `land_depth_loss`."""
    found = []
    with torch.inference_mode():
        for photo in photos:
            batch = normalised([sized(photo, config.width, config.height)])
            logits, found_here = network(batch)
            found.append(float(land_depth_loss(found_here, depth(batch)[1], _land(logits))))
    return np.array(found)


def land_depth_loss(log_inverse: Tensor, wanted: Tensor, land: Tensor) -> Tensor:
    """Mean |log ratio| of inverse depth (N, 1, h, w) to that wanted, after each photo's own scale (its mean), where
    `land` is true: of the sky nobody asks for depth."""
    land = land.float()
    count = land.sum((1, 2, 3), keepdim=True).clamp(min=1.0)
    residual = (log_inverse - wanted) * land
    residual = (residual - residual.sum((1, 2, 3), keepdim=True) / count * land).abs()
    return (residual.sum((1, 2, 3), keepdim=True) / count).mean()


def _land(logits: Tensor) -> Tensor:
    """(N, 1, h, w): where the classes of largest logits (N, K, 2 h, 2 w) are not sky."""
    return logits[:, :, ::2, ::2].argmax(1, keepdim=True) != Label.SKY


def _window(
    frames: list[Frame],
    network: LandscapeNetwork,
    teacher: LandscapeNetwork,
    config: DepthPyramidConfig,
    rng: np.random.Generator,
) -> _Window:
    frame = frames[int(rng.integers(len(frames)))]
    photo, _, inverse = augmented(frame, (config.height, config.width), config.augment, rng)
    batch = normalised([photo]).to(device())
    with torch.no_grad():
        maps = network.encoder(batch)
        logits, _ = network.heads(maps)
        wanted = teacher(batch)[1]
    return _Window(
        tuple(m[0].half().cpu() for m in maps[1:]),
        wanted[0].cpu(),
        _land(logits)[0].cpu(),
        torch.from_numpy(np.log(inverse[2::4, 2::4]))[None],
    )


def _sized(frame: Frame, config: DepthPyramidConfig) -> Frame:
    """At the network's size, without a depth that is an order only."""
    size = (config.width, config.height)
    inverse = None if frame.ordinal else frame.inverse
    return replace(
        frame,
        image=sized(frame.image, *size),
        labels=np.asarray(cv2.resize(frame.labels, size, interpolation=cv2.INTER_NEAREST), np.uint8),
        inverse=None if inverse is None else cv2.resize(inverse, size, interpolation=cv2.INTER_NEAREST),
    )
