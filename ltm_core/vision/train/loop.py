"""The training run: the same configuration, frames and seed give the same weights on the same machine type."""

import copy
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from ltm_core.errors import ModelError
from ltm_core.metrics.segmentation import SegmentationScore
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_core.vision.train.augment import OUTSIDE, augmented
from ltm_core.vision.train.config import OptimiserConfig, TrainingConfig
from ltm_core.vision.train.frames import Frame, Split
from ltm_core.vision.train.network import SpineNetwork

# The exported network's normalisation; the manifest states the same.
MEAN, STD = (0.45, 0.46, 0.45), (0.25, 0.25, 0.27)


@dataclass(frozen=True)
class Progress:
    """State after a step; `validation` is set on the steps that validate."""

    step: int
    loss: float
    validation: SegmentationScore | None
    best: float


def train(
    config: TrainingConfig, split: Split, classes: int, report: Callable[[Progress], None]
) -> tuple[SpineNetwork, SegmentationScore]:
    """Train on `split.train`; gives the network with averaged weights and its score on `split.validation`.

    They are the weights that scored best (mean IoU), or the last ones where no frames validate.
    """
    torch.manual_seed(config.seed)
    network = SpineNetwork(classes, config.network).to(memory_format=torch.channels_last)
    average = copy.deepcopy(network).eval()
    optimiser = torch.optim.AdamW(
        network.parameters(), lr=config.optimiser.learning_rate, weight_decay=config.optimiser.weight_decay
    )
    weights = _class_weights(split.train, classes, config.optimiser.class_weight_power)
    best, best_score, best_state = -1.0, SegmentationScore.empty(classes), average.state_dict()
    for step, (photos, labels) in enumerate(_batches(config, split.train), start=1):
        for group in optimiser.param_groups:
            group["lr"] = _learning_rate(config.optimiser, step)
        network.train()
        loss = _loss(network(photos), labels, weights, config.optimiser)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        if not torch.isfinite(torch.nn.utils.clip_grad_norm_(network.parameters(), 2.0)):
            raise ModelError(f"training diverged at step {step}; lower optimiser.learning_rate or lengthen its warmup")
        optimiser.step()
        # A short memory at first, so that the average does not drag the random start along.
        _follow(average, network, min(config.optimiser.average, step / (step + 10)))
        validation = None
        if split.validation and (step % config.optimiser.validate_every == 0 or step == config.optimiser.steps):
            validation = score(average, split.validation, config, classes)
            if validation.mean_iou > best:
                best, best_score, best_state = validation.mean_iou, validation, copy.deepcopy(average.state_dict())
        report(Progress(step, float(loss.detach()), validation, best))
    if split.validation:
        average.load_state_dict(best_state)
    return average, best_score


def score(network: SpineNetwork, frames: list[Frame], config: TrainingConfig, classes: int) -> SegmentationScore:
    """The network's labels of unchanged frames against their truth, at the frames' own size."""
    result = SegmentationScore.empty(classes)
    network.eval()
    with torch.inference_mode():
        for frame in frames:
            height, width = frame.labels.shape
            logits = network(_tensor([_at_size(frame.image, config)]))
            large = functional.interpolate(logits, (height, width), mode="bilinear", align_corners=False)
            result = result.plus(frame.labels, large[0].argmax(0).numpy().astype(np.uint8))
    return result


def _at_size(image: npt.NDArray[np.uint8], config: TrainingConfig) -> npt.NDArray[np.uint8]:
    if image.shape[:2] == (config.height, config.width):
        return image
    return np.asarray(cv2.resize(image, (config.width, config.height), interpolation=cv2.INTER_AREA), np.uint8)


def _batches(config: TrainingConfig, frames: list[Frame]) -> Iterator[tuple[Tensor, Tensor]]:
    """Augmented batches, made one ahead beside the training; what is in a batch depends on seed and step alone."""
    count, small_steps = config.optimiser.batch, round(config.optimiser.small * config.optimiser.steps)

    def batch(step: int) -> tuple[Tensor, Tensor]:
        size = _two_thirds(config) if step < small_steps else (config.height, config.width)
        # Frames come in shuffled rounds: each is seen equally often.
        chosen = [_shuffled(config.seed, len(frames), step * count + index) for index in range(count)]
        rng = np.random.default_rng([config.seed, 1, step])
        pairs = [augmented(frames[i].image, frames[i].labels, size, config.augment, rng) for i in chosen]
        return _tensor([photo for photo, _ in pairs]), torch.from_numpy(np.stack([truth for _, truth in pairs]))

    with ThreadPoolExecutor(1) as maker:
        following = maker.submit(batch, 0)
        for step in range(config.optimiser.steps):
            current = following.result()
            if step + 1 < config.optimiser.steps:
                following = maker.submit(batch, step + 1)
            yield current


def _two_thirds(config: TrainingConfig) -> tuple[int, int]:
    """(height, width) of the first steps: less than half the work, and the scenes at another scale."""
    return max(64, round(config.height / 48) * 32), max(64, round(config.width / 48) * 32)


def _shuffled(seed: int, count: int, index: int) -> int:
    """Element `index` of an endless row of shuffles of 0..count-1."""
    rounds, place = divmod(index, count)
    return int(np.random.default_rng([seed, 0, rounds]).permutation(count)[place])


def _tensor(photos: list[npt.NDArray[np.uint8]]) -> Tensor:
    unit = torch.from_numpy(np.stack(photos)).float() / 255.0
    return ((unit - torch.tensor(MEAN)) / torch.tensor(STD)).permute(0, 3, 1, 2)  # channels last in memory


def _class_weights(frames: list[Frame], classes: int, power: float) -> Tensor:
    counts = np.sum([np.bincount(frame.labels.ravel(), minlength=256)[:classes] for frame in frames], axis=0)
    share = counts / counts.sum()
    weights = np.where(counts > 0, np.maximum(share, 1e-3) ** -power, 1.0)
    return torch.from_numpy((weights / (weights * share).sum()).astype(np.float32))


def _loss(logits: Tensor, labels: Tensor, weights: Tensor, config: OptimiserConfig) -> Tensor:
    """Weighted cross-entropy at the labels' resolution; unlabelled ground counts only against sky."""
    large = functional.interpolate(logits, labels.shape[1:], mode="bilinear", align_corners=False)
    target = labels.long()
    target[labels == OUTSIDE] = UNLABELLED
    loss = functional.cross_entropy(
        large, target, weights, ignore_index=UNLABELLED, label_smoothing=config.label_smoothing
    )
    ground = labels == UNLABELLED
    if config.unlabelled_not_sky > 0 and bool(ground.any()):
        others = torch.cat([large[:, : Label.SKY], large[:, Label.SKY + 1 :]], dim=1)
        not_sky = torch.logsumexp(others, dim=1) - torch.logsumexp(large, dim=1)
        loss = loss - config.unlabelled_not_sky * not_sky[ground].sum() / labels.numel()
    return loss


def _learning_rate(config: OptimiserConfig, step: int) -> float:
    """Linear warm-up, then half a cosine down to nothing."""
    warmup = max(1.0, config.warmup * config.steps)
    if step < warmup:
        return config.learning_rate * step / warmup
    rest = (step - warmup) / max(1.0, config.steps - warmup)
    return config.learning_rate * 0.5 * (1.0 + float(np.cos(np.pi * rest)))


def _follow(average: SpineNetwork, network: SpineNetwork, decay: float) -> None:
    with torch.no_grad():
        for old, new in zip(average.state_dict().values(), network.state_dict().values(), strict=True):
            if old.is_floating_point():
                old.lerp_(new, 1.0 - decay)
            else:
                old.copy_(new)
