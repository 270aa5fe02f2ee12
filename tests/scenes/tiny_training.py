"""Small drawn frames to train on, and a training of seconds."""

from pathlib import Path

import cv2
import numpy as np

from ltm_core.base.types import UInt8Array
from ltm_core.vision.labels import Label
from ltm_lab.training.borrow import fractal_noise
from ltm_lab.training.config import AugmentConfig, NetworkConfig, OptimiserConfig, SplitConfig, TrainingConfig

SIZE = (64, 96)
COLORS = np.array([(140, 190, 235), (200, 190, 90), (110, 90, 50), (20, 70, 30), (160, 150, 140)], np.uint8)


def drawn_frame(seed: int) -> tuple[UInt8Array, UInt8Array]:
    """Sky over patches of grass, shrub, tree and bare ground, each in its own colour."""
    rng = np.random.default_rng(seed)
    labels = (1 + np.minimum(fractal_noise(SIZE, rng, octaves=2) * 4, 3)).astype(np.uint8)
    labels[: int(rng.integers(15, 35))] = Label.SKY
    noise = rng.normal(0.0, 5.0, (*SIZE, 3))
    return np.clip(COLORS[labels] + noise, 0, 255).astype(np.uint8), labels


def write_drawn(folder: Path, seed: int, labels: UInt8Array | None = None) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    image, truth = drawn_frame(seed)
    cv2.imwrite(str(folder / f"{seed:04d}.png"), image[..., ::-1])
    cv2.imwrite(str(folder / f"{seed:04d}_labels.png"), truth if labels is None else labels)


TINY = TrainingConfig(
    name="tiny",
    width=96,
    height=64,
    deploy_width=96,
    deploy_height=64,
    seed=3,
    split=SplitConfig(validation=("elm",), test=("oak",)),
    network=NetworkConfig(width=16, pretrained=False, fixed=0),
    optimiser=OptimiserConfig(
        steps=30, batch=4, validate_every=15, learning_rate=0.01, encoder_rate=1.0, average=0.8, frozen=0.0
    ),
    augment=AugmentConfig(photo_look=0, new_sky=0, ground_tint=0, snow=0, haze=0, light=0, grey=0, noise=0.5, jpeg=0),
)


def with_steps(config: TrainingConfig, steps: int) -> TrainingConfig:
    return config.model_copy(update={"optimiser": config.optimiser.model_copy(update={"steps": steps})})
