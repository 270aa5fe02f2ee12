"""The training loop: the same configuration, frames and seed give the same weights on the same machine type."""

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional
from torch.utils.data import DataLoader, Dataset

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.base.types import UInt8Array
from ltm_core.scoring.labels import SegmentationScore
from ltm_lab.training.augment import Lent, augmented
from ltm_lab.training.borrow import with_ground
from ltm_lab.training.config import OptimiserConfig, TrainingConfig
from ltm_lab.training.landscape_network import LandscapeNetwork, for_inference
from ltm_lab.training.losses import Batch, kept_depth_loss, kept_labels_loss, total_loss
from ltm_lab.training.training_frames import Split, TrainingFrame

# ImageNet's, as the encoder's weights expect; the exported manifest states the same.
MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


@dataclass(frozen=True)
class Progress:
    """State after a step; `validation` is set on the steps that validate."""

    step: int
    loss: float
    validation: SegmentationScore | None
    best: float


@dataclass
class Run:
    """All that a run needs to go on: the network, its averaged weights, the optimiser, and the history so far."""

    network: LandscapeNetwork
    average: LandscapeNetwork
    optimiser: torch.optim.Optimizer
    step: int = 0
    best: float = -1.0
    best_state: dict[str, Any] | None = None
    losses: list[float] = field(default_factory=list)
    validations: list[tuple[int, float]] = field(default_factory=list)
    before: LandscapeNetwork | None = None  # as it was at the start, if its depth or labels are to be kept

    @classmethod
    def start(cls, config: TrainingConfig, classes: int, weights: dict[str, Any] | None = None) -> "Run":
        """From ImageNet's encoder, or from `weights` of an earlier training: of a checkpoint or of an exported file.

        Weights of an exported file have their batch normalisations folded in, and so has the network that goes on from
        them; it has the optional parts that theirs has. Raises ConfigError for weights of another architecture.
        """
        torch.manual_seed(config.seed)
        form = config.network
        if weights is not None:
            form = form.with_parts_of(weights)
        network = LandscapeNetwork(classes, form)
        if weights is not None:
            if not any(name.endswith("running_mean") for name in weights):
                network = for_inference(network)
            try:
                network.load_state_dict(weights)
            except RuntimeError as reason:
                raise ConfigError(
                    f"the weights to start from are those of another network than configured for {classes} classes and "
                    f"width {config.network.width}: {str(reason).splitlines()[1].strip()}"
                ) from reason
        elif config.network.pretrained:
            network.encoder.load_imagenet()
        network = network.to(device(), memory_format=torch.channels_last)
        rate, encoder = config.optimiser.learning_rate, set(network.encoder.parameters())
        groups = [
            {"params": [p for p in network.parameters() if p not in encoder], "scale": 1.0},
            {"params": list(encoder_parameters(network)), "scale": config.optimiser.encoder_rate},
        ]
        optimiser = torch.optim.AdamW(groups, lr=rate, weight_decay=config.optimiser.weight_decay)
        keeps = config.optimiser.keep_depth > 0 or config.optimiser.keep_labels > 0
        before = copy.deepcopy(network).eval() if keeps else None
        return cls(network, copy.deepcopy(network).eval(), optimiser, before=before)

    def save(self, path: Path, config: TrainingConfig) -> None:
        """Write a checkpoint, whole or not at all."""
        content = {
            "config": config.model_dump(mode="json"),
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "step": self.step,
            "best": self.best,
            "best_state": self.best_state,
            "losses": self.losses,
            "validations": self.validations,
            "before": None if self.before is None else self.before.state_dict(),
        }
        part = path.with_suffix(".part")
        torch.save(content, part)
        part.replace(path)

    @classmethod
    def resume(cls, path: Path, config: TrainingConfig, classes: int) -> "Run":
        """Read a checkpoint of the same configuration. Raises ConfigError where it is another's."""
        content = torch.load(path, map_location=device(), weights_only=True)
        differing = sorted(
            key for key, value in config.model_dump(mode="json").items() if content["config"].get(key) != value
        )
        if differing:
            raise ConfigError(
                f"{path}: was made with other values of {', '.join(differing)}; resume with the configuration it was "
                "made with, or train into another folder"
            )
        run = cls.start(config, classes, content["network"])
        run.average.load_state_dict(content["average"])
        run.optimiser.load_state_dict(content["optimiser"])
        run.step, run.best, run.best_state = content["step"], content["best"], content["best_state"]
        if run.before is not None:
            run.before.load_state_dict(content["before"])
        run.losses, run.validations = content["losses"], [(int(s), float(v)) for s, v in content["validations"]]
        return run


def encoder_parameters(network: LandscapeNetwork) -> Iterator[torch.nn.Parameter]:
    yield from network.encoder.parameters()


def device() -> torch.device:
    """A GPU where there is one."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def train(
    config: TrainingConfig,
    split: Split,
    classes: int,
    report: Callable[[Progress], None],
    run: Run | None = None,
    checkpoint: Path | None = None,
) -> tuple[LandscapeNetwork, Run]:
    """Train on `split.train`; gives the network with averaged weights, and the run.

    They are the weights that scored best on `split.validation` (mean F1 of the classes that occur), or the last ones
    where no frames validate. With `checkpoint`, the run is written there at every validation, for `Run.resume`.
    """
    run = Run.start(config, classes) if run is None else run
    optimiser, settings = run.optimiser, config.optimiser
    weights = _class_weights(split.train, classes, settings.class_weight_power).to(device())
    last = settings.steps
    for step, batch in enumerate(_batches(config, split.train, run.step), start=run.step + 1):
        for group in optimiser.param_groups:
            group["lr"] = _learning_rate(settings, step) * group["scale"]
        frozen = step <= settings.frozen * settings.steps
        run.network.train()
        run.network.encoder.eval()  # its statistics are those of a million photos; ours are of a few scenes
        photos = batch.photos.to(memory_format=torch.channels_last)
        with torch.set_grad_enabled(not frozen):
            maps = run.network.encoder(photos)
        logits, log_inverse = run.network.heads(maps, photos)
        loss = total_loss(logits, log_inverse, batch, weights, settings)
        if run.before is not None:
            with torch.no_grad():
                old_logits, before = run.before(photos)
            if settings.keep_depth > 0:
                loss = loss + settings.keep_depth * kept_depth_loss(log_inverse, before)
            if settings.keep_labels > 0:
                loss = loss + settings.keep_labels * kept_labels_loss(logits, old_logits, batch.labels)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        if not torch.isfinite(
            torch.nn.utils.clip_grad_norm_([p for p in run.network.parameters() if p.grad is not None], 2.0)
        ):
            raise ModelError(f"training diverged at step {step}; lower optimiser.learning_rate or lengthen its warmup")
        optimiser.step()
        # A short memory at first, so that the average does not drag the random start along.
        _follow(run.average, run.network, min(settings.average, step / (step + 10)))
        run.step = step
        run.losses.append(float(loss.detach()))
        validation = None
        if step % settings.validate_every == 0 or step == last:
            if split.validation:
                validation = score(run.average, split.validation, config, classes)
                run.validations.append((step, validation.macro_f1()))
                if validation.macro_f1() > run.best:
                    run.best, run.best_state = validation.macro_f1(), copy.deepcopy(run.average.state_dict())
            if checkpoint is not None:
                run.save(checkpoint, config)
        report(Progress(step, run.losses[-1], validation, run.best))
    result = copy.deepcopy(run.average)
    if run.best_state is not None:
        result.load_state_dict(run.best_state)
    return result.cpu().eval(), run


def score(
    network: LandscapeNetwork, frames: list[TrainingFrame], config: TrainingConfig, classes: int
) -> SegmentationScore:
    """The network's labels of unchanged frames against their truth, at the frames' own size."""
    result = SegmentationScore.empty(classes)
    network.eval()
    size = (config.deploy_width, config.deploy_height)
    with torch.inference_mode():
        for frame in frames:
            height, width = frame.labels.shape
            logits, _ = network(normalised([_at_size(frame.image, size)]).to(device()))
            large = functional.interpolate(logits, (height, width), mode="bilinear", align_corners=False)
            result = result.plus(frame.labels, large[0].argmax(0).cpu().numpy().astype(np.uint8))
    return result


def normalised(photos: list[UInt8Array]) -> Tensor:
    """Photos (H, W, 3) of one size -> the network's input (N, 3, H, W)."""
    unit = torch.from_numpy(np.stack(photos)).float() / 255.0
    return ((unit - torch.tensor(MEAN)) / torch.tensor(STD)).permute(0, 3, 1, 2)  # channels last in memory


def _at_size(image: UInt8Array, size: tuple[int, int]) -> UInt8Array:
    if image.shape[1::-1] == size:
        return image
    shrinks = size[0] <= image.shape[1] and size[1] <= image.shape[0]  # as the segmenter resizes
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR), np.uint8)


def _batches(config: TrainingConfig, frames: list[TrainingFrame], done: int) -> Iterator[Batch]:
    """Augmented batches after the first `done`, made ahead; what is in a batch depends on seed and step alone."""
    workers, there = config.optimiser.workers, device()
    loader = DataLoader(
        _Steps(config, frames),
        sampler=range(done, config.optimiser.steps),
        batch_size=None,
        num_workers=workers,
        pin_memory=there.type == "cuda",
        multiprocessing_context="fork" if workers else None,
        prefetch_factor=4 if workers else None,
    )
    mean, std = (torch.tensor(v, device=there) * 255.0 for v in (MEAN, STD))
    for photos, *others in loader:
        unit = (photos.to(there, non_blocking=True).float() - mean) / std  # bytes travel, not floats
        yield Batch(unit.permute(0, 3, 1, 2), *(value.to(there, non_blocking=True) for value in others))


class _Steps(Dataset):  # type: ignore[misc]  # torch is not typed for us
    """Batches by their step: photos (N, H, W, 3) uint8, labels, inverse depth, whether it is an order."""

    def __init__(self, config: TrainingConfig, frames: list[TrainingFrame]) -> None:
        self._config, self._frames = config, frames
        self._deck, self._lent = Deck(frames, config.shares, config.seed), Lent.by(frames)
        self._rendered = [frame for frame in frames if not frame.ordinal]
        self._small = round(config.optimiser.small * config.optimiser.steps)

    def __getitem__(self, step: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        config, lent = self._config, self._lent
        if config.optimiser.workers:
            cv2.setNumThreads(0)  # a process for each batch is enough
        count = config.optimiser.batch
        size = _two_thirds(config) if step < self._small else (config.height, config.width)
        chosen = [self._frames[self._deck.card(step * count + index)] for index in range(count)]
        rng = np.random.default_rng([config.seed, 1, step])
        windows = [augmented(frame, size, config.augment, rng, lent) for frame in chosen]
        for index, frame in enumerate(chosen):
            if (
                config.augment.lent_ground > 0
                and frame.ordinal
                and self._rendered
                and rng.random() < config.augment.lent_ground
            ):
                donor_frame = self._rendered[int(rng.integers(len(self._rendered)))]
                windows[index] = with_ground(
                    windows[index], augmented(donor_frame, size, config.augment, rng, lent), rng
                )
        return (
            torch.from_numpy(np.stack([photo for photo, _, _ in windows])),
            torch.from_numpy(np.stack([labels for _, labels, _ in windows])),
            torch.from_numpy(np.stack([inverse for _, _, inverse in windows])),
            torch.tensor([frame.ordinal for frame in chosen]),
        )


class Deck:
    """An endless row of frames in shuffled rounds: each frame of a set is seen equally often.

    `shares`: set -> the share of the row that is drawn from it; sets without one divide the rest by their numbers of
    frames. Raises ConfigError for a share of a set that has no frame.
    """

    def __init__(self, frames: list[TrainingFrame], shares: dict[str, float], seed: int) -> None:
        members: dict[str, list[int]] = {}
        for index, frame in enumerate(frames):
            name = frame.path.parent.name
            members.setdefault(name if name in shares else "", []).append(index)
        absent = sorted(set(shares) - set(members))
        if absent:
            raise ConfigError(f"shares names {', '.join(absent)}: no such set of frames to train on")
        if not members:
            raise ConfigError("no frames to train on: every set is held out by split")
        self._members = list(members.values())
        rest = 1.0 - sum(shares.values())
        parts = np.array([shares.get(name, rest) for name in members])
        self._edges = np.cumsum(parts / parts.sum())
        self._seed = seed

    def card(self, index: int) -> int:
        """The frame at place `index` of the row."""
        # Golden-ratio steps spread each set evenly over the row.
        place = float((index * 0.6180339887498949) % 1.0)
        group = int(np.searchsorted(self._edges, place, side="right"))
        group = min(group, len(self._members) - 1)
        members = self._members[group]
        share = self._edges[group] - (self._edges[group - 1] if group else 0.0)
        rounds, position = divmod(int(index * share), len(members))
        return members[int(np.random.default_rng([self._seed, 0, group, rounds]).permutation(len(members))[position])]


def _two_thirds(config: TrainingConfig) -> tuple[int, int]:
    """(height, width) of the first steps: less than half the work, and the scenes at another scale."""
    return max(64, round(config.height / 48) * 32), max(64, round(config.width / 48) * 32)


def _class_weights(frames: list[TrainingFrame], classes: int, power: float) -> Tensor:
    counts = np.sum([np.bincount(frame.labels.ravel(), minlength=256)[:classes] for frame in frames], axis=0)
    share = counts / max(1, counts.sum())
    weights = np.where(counts > 0, np.maximum(share, 1e-3) ** -power, 1.0)
    return torch.from_numpy((weights / max(float((weights * share).sum()), 1e-9)).astype(np.float32))


def _learning_rate(config: OptimiserConfig, step: int) -> float:
    """Linear warm-up, then half a cosine down to nothing."""
    warmup = max(1.0, config.warmup * config.steps)
    if step < warmup:
        return config.learning_rate * float(step / warmup)
    rest = (step - warmup) / max(1.0, config.steps - warmup)
    return config.learning_rate * 0.5 * (1.0 + float(np.cos(np.pi * rest)))


def _follow(average: LandscapeNetwork, network: LandscapeNetwork, decay: float) -> None:
    with torch.no_grad():
        for old, new in zip(average.state_dict().values(), network.state_dict().values(), strict=True):
            if old.is_floating_point():
                old.lerp_(new, 1.0 - decay)
            else:
                old.copy_(new)
