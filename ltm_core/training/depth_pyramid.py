"""Gives a network of labels the depth of another one: one encoder then serves both, and a frame costs one run.

Encoder and labels stay what they are, to the bit. A pyramid for depth alone begins with the other network's weights,
whose encoder is an earlier state of this one's, and learns on photos without any truth to say what that one says. After
Hinton et al. 2015 (distillation).
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from ltm_core.errors import ModelError
from ltm_core.strict_model import StrictModel
from ltm_core.training.adapt import sized
from ltm_core.training.augment import augmented
from ltm_core.training.config import AugmentConfig, NetworkConfig
from ltm_core.training.labelled_frames import UNKNOWN, Frame
from ltm_core.training.landscape_network import LandscapeNetwork, for_inference
from ltm_core.training.loop import device, normalised
from ltm_core.types import Float64Array, UInt8Array
from ltm_core.vision.labels import Label

_HEAD = ("own.", "depth.", "inverse.")


class DepthPyramidConfig(StrictModel):
    """How the pyramid is taught. `width`, `height`: of what photos are brought to; whole photos, as they are asked
    for later, since the context of rows and columns is a whole photo's."""

    steps: int = Field(default=1300, ge=1)
    batch: int = Field(default=4, ge=1)
    learning_rate: float = Field(default=1e-3, gt=0)
    average: float = Field(default=0.99, ge=0, lt=1)
    seed: int = 0
    width: int = Field(default=640, ge=64, multiple_of=32)
    height: int = Field(default=352, ge=64, multiple_of=32)
    augment: AugmentConfig = AugmentConfig(new_sky=0, ground_tint=0, snow=0, haze=0)  # these need labels


def with_depth_of(
    labels: LandscapeNetwork,
    depth: LandscapeNetwork,
    photos: list[UInt8Array],
    config: DepthPyramidConfig,
    report: Callable[[int, float], None],
) -> LandscapeNetwork:
    """The labels' network with the other's depth, both in their exported form; `photos`: (H, W, 3) RGB.

    `report` gets step and loss. Raises ModelError without photos, and for networks of different shapes.
    """
    if not photos:
        raise ModelError("no photos to learn on")
    torch.manual_seed(config.seed)
    network = joined(labels, depth)
    network.to(device()).eval()
    teacher = depth.to(device()).eval()
    for name, parameter in network.named_parameters():
        parameter.requires_grad_(name.startswith(_HEAD))
    taught = [p for p in network.parameters() if p.requires_grad]
    means = [p.detach().clone() for p in taught]
    optimiser = torch.optim.AdamW(taught, lr=config.learning_rate, weight_decay=0.0)
    for step in range(1, config.steps + 1):
        for group in optimiser.param_groups:
            group["lr"] = config.learning_rate * 0.5 * (1.0 + np.cos(np.pi * step / config.steps))
        rng = np.random.default_rng([config.seed, step])
        batch = normalised([_window(photos[i], config, rng) for i in rng.integers(0, len(photos), config.batch)])
        batch = batch.to(device())
        with torch.no_grad():
            _, wanted = teacher(batch)
        logits, found = network(batch)
        loss = land_depth_loss(found, wanted, logits.detach())
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        with torch.no_grad():
            for mean, value in zip(means, taught, strict=True):
                mean.lerp_(value, 1.0 - min(config.average, step / (step + 10)))
        report(step, float(loss.detach()))
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
    config = NetworkConfig(width=width, pretrained=False, fixed=16, own_depth=True)
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
            found.append(float(land_depth_loss(found_here, depth(batch)[1], logits)))
    return np.array(found)


def land_depth_loss(log_inverse: Tensor, wanted: Tensor, logits: Tensor) -> Tensor:
    """Mean |log ratio| of inverse depth (N, 1, h, w) to that wanted, after each photo's own scale (its mean), where
    the classes of largest logits (N, K, 2 h, 2 w) are not sky, whose depth nobody asks for."""
    land = (logits[:, :, ::2, ::2].argmax(1, keepdim=True) != Label.SKY).float()
    count = land.sum((1, 2, 3), keepdim=True).clamp(min=1.0)
    residual = (log_inverse - wanted) * land
    residual = (residual - residual.sum((1, 2, 3), keepdim=True) / count * land).abs()
    return (residual.sum((1, 2, 3), keepdim=True) / count).mean()


def _window(photo: UInt8Array, config: DepthPyramidConfig, rng: np.random.Generator) -> UInt8Array:
    photo = sized(photo, config.width, config.height)
    frame = Frame(photo, np.full(photo.shape[:2], UNKNOWN, np.uint8), Path("photo"), None)
    return augmented(frame, (config.height, config.width), config.augment, rng)[0]
