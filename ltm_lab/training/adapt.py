"""Adapts the depth head of a finished network to a site's own cameras, with traced depth as truth.

Only the depth head changes, so the labels of the network stay what they were, pixel for pixel.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import torch
from pydantic import Field
from torch.nn import functional

from ltm_core.base.errors import ModelError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.label_heads.labelled_frames import UNKNOWN
from ltm_lab.training.augment import augmented
from ltm_lab.training.config import AugmentConfig
from ltm_lab.training.landscape_network import LandscapeNetwork
from ltm_lab.training.loop import device, normalised
from ltm_lab.training.losses import Batch, depth_loss
from ltm_lab.training.training_frames import TrainingFrame

_HEAD = ("depth.", "inverse.")


class AdaptConfig(StrictModel):
    """How the depth head is taught; a few hundred small steps, for a few cameras teach little and forget much."""

    steps: int = Field(default=200, ge=1)
    batch: int = Field(default=4, ge=1)
    learning_rate: float = Field(default=5e-4, gt=0)
    seed: int = 0
    width: int = Field(default=512, ge=64, multiple_of=32)
    height: int = Field(default=288, ge=64, multiple_of=32)
    augment: AugmentConfig = AugmentConfig(new_sky=0, ground_tint=0, snow=0, haze=0)  # these need labels


def adapted(
    network: LandscapeNetwork, frames: list[TrainingFrame], config: AdaptConfig, report: Callable[[int, float], None]
) -> LandscapeNetwork:
    """A copy of a network in its exported form whose depth head has been taught on frames with true inverse depth.

    `report` gets step and loss. Raises ModelError where no frame has depth.
    """
    frames = [frame for frame in frames if frame.inverse is not None and np.isfinite(frame.inverse).any()]
    if not frames:
        raise ModelError("no frame has traced depth to learn from")
    torch.manual_seed(config.seed)
    network = copy.deepcopy(network).to(device()).eval()
    for name, parameter in network.named_parameters():
        parameter.requires_grad_(name.startswith(_HEAD))
    taught = [p for p in network.parameters() if p.requires_grad]
    optimiser = torch.optim.AdamW(taught, lr=config.learning_rate, weight_decay=0.01)
    for step in range(1, config.steps + 1):
        for group in optimiser.param_groups:
            group["lr"] = config.learning_rate * 0.5 * (1.0 + np.cos(np.pi * step / config.steps))
        rng = np.random.default_rng([config.seed, step])
        chosen = [frames[i] for i in rng.integers(0, len(frames), config.batch)]
        windows = [augmented(frame, (config.height, config.width), config.augment, rng) for frame in chosen]
        inverse = torch.from_numpy(np.stack([w[2] for w in windows])).to(device())
        labels = torch.from_numpy(np.stack([w[1] for w in windows])).to(device())
        photos = normalised([w[0] for w in windows]).to(device())
        _, log_inverse = network(photos)
        loss = depth_loss(log_inverse, Batch(photos, labels, inverse, torch.zeros(len(chosen), dtype=torch.bool)))
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        report(step, float(loss.detach()))
    network.cpu()
    return network


def depth_error(network: LandscapeNetwork, frames: list[TrainingFrame], config: AdaptConfig) -> float:
    """Median over frames of the median |log ratio| to the true depth after each frame's own scale: 0.1 is 10 %."""
    errors = []
    with torch.inference_mode():
        for frame in frames:
            if frame.inverse is None:
                continue
            photo = sized(frame.image, config.width, config.height)
            _, log_inverse = network(normalised([photo]))
            large = functional.interpolate(log_inverse, frame.inverse.shape, mode="bilinear", align_corners=False)
            ratio = large[0, 0].numpy() - np.log(frame.inverse)
            ratio = ratio[np.isfinite(ratio)]
            if ratio.size:
                errors.append(float(np.median(np.abs(ratio - np.median(ratio)))))
    return float(np.median(errors)) if errors else float("nan")


def sized(image: UInt8Array, width: int, height: int) -> UInt8Array:
    """A photo (H, W, 3) in another size, aspect not kept."""
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def frame_of(image: UInt8Array, depth: Float32Array, name: str, width: int) -> TrainingFrame:
    """A frame to learn from, `width` wide or less, of a photo (H, W, 3) and its traced depth (H, W), metres along the
    optical axis, +inf sky, NaN unknown."""
    height, full = image.shape[:2]
    small = (width, max(1, round(height * width / full))) if full > width else (full, height)
    known = np.isfinite(depth) & (depth > 0)
    inverse = np.divide(1.0, depth, out=np.full(depth.shape, np.nan, np.float32), where=known)
    return TrainingFrame(
        np.asarray(cv2.resize(image, small, interpolation=cv2.INTER_AREA), np.uint8),
        np.full(small[::-1], UNKNOWN, np.uint8),
        Path(name),
        np.asarray(cv2.resize(inverse, small, interpolation=cv2.INTER_NEAREST), np.float32),
    )
