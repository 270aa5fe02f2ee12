"""Loss functions: classes and partial knowledge of them, inverse depth of free scale, a teacher's depth order."""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from ltm_core.label_heads.labelled_frames import LAND, UNKNOWN
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_lab.training.config import OptimiserConfig
from ltm_lab.training.statements import absent, stated

_PAIRS = 600  # of pixels, drawn in each frame whose order of near and far a teacher gives
_CLEAR = 0.12  # of the teacher's spread between the 5th and 95th percentile: a smaller step is no order
_NO_LAND = (Label.SKY, Label.WATER, Label.BUILT)


class Batch(NamedTuple):
    """Windows of frames: photos (N, 3, H, W) normalised, labels (N, H, W) uint8, inverse depth (N, H, W) with NaN
    where unknown, and for each window whether its inverse depth is an order only."""

    photos: Tensor
    labels: Tensor
    inverse: Tensor
    ordinal: Tensor


def total_loss(logits: Tensor, log_inverse: Tensor, batch: Batch, weights: Tensor, config: OptimiserConfig) -> Tensor:
    """Weighted sum of the losses below."""
    loss = class_loss(logits, batch.labels, weights, config)
    if config.depth > 0:
        loss = loss + config.depth * depth_loss(log_inverse, batch)
    if config.order > 0:
        loss = loss + config.order * order_loss(log_inverse, batch)
    return loss


def class_loss(logits: Tensor, labels: Tensor, weights: Tensor, config: OptimiserConfig) -> Tensor:
    """Weighted cross-entropy at the labels' resolution; pixels without a class count against what they cannot be."""
    large = functional.interpolate(logits, labels.shape[1:], mode="bilinear", align_corners=False)
    target = labels.long()
    target[labels >= len(weights)] = UNLABELLED
    loss = functional.cross_entropy(
        large, target, weights, ignore_index=UNLABELLED, label_smoothing=config.label_smoothing
    )
    if not torch.isfinite(loss):  # a batch without one labelled pixel
        loss = large.sum() * 0.0
    there = labels.unique().cpu().numpy()
    said = [(int(label), absent(int(label))) for label in there[stated(there)]]
    for partial, impossible in ((UNLABELLED, (Label.SKY,)), (LAND, _NO_LAND), *said):
        here = labels == partial
        if config.partial > 0 and impossible and bool(here.any()):
            possible = [k for k in range(len(weights)) if k not in impossible]
            within = torch.logsumexp(large[:, possible], dim=1) - torch.logsumexp(large, dim=1)
            loss = loss - config.partial * within[here].sum() / labels.numel()
    return loss


def depth_loss(log_inverse: Tensor, batch: Batch) -> Tensor:
    """Mean |log ratio| to the true inverse depth after each window's own scale (its median), plus that of steps.

    Scale-invariant in the sense of Eigen et al. 2014, with absolute values: silhouettes are wrong by a lot. Pixels at
    silhouettes, where a small shift changes the truth by a factor, are left out.
    """
    large = functional.interpolate(log_inverse, batch.inverse.shape[1:], mode="bilinear", align_corners=False)[:, 0]
    truth = torch.log(batch.inverse)
    known = torch.isfinite(truth) & ~batch.ordinal[:, None, None]
    if not bool(known.any()):
        return log_inverse.sum() * 0.0
    residual = torch.where(known, large - torch.where(known, truth, 0.0), torch.nan)
    scale = residual.detach().flatten(1).nanmedian(dim=1).values
    residual = residual - torch.nan_to_num(scale)[:, None, None]
    kept = known & ~_silhouettes(truth)
    loss = residual[kept].abs().mean() if bool(kept.any()) else log_inverse.sum() * 0.0
    for step in (1, 4, 16):
        for axis in (1, 2):
            length = residual.shape[axis] - step
            change = residual.narrow(axis, step, length) - residual.narrow(axis, 0, length)
            both = torch.isfinite(change)
            if bool(both.any()):
                loss = loss + 0.1 * change[both].abs().clamp(max=1.0).mean()
    return loss


def kept_depth_loss(log_inverse: Tensor, before: Tensor) -> Tensor:
    """Mean |log ratio| of inverse depth to that of an earlier network, after each window's own scale (its mean)."""
    residual = log_inverse - before
    return (residual - residual.mean((1, 2, 3), keepdim=True)).abs().mean()


def kept_labels_loss(logits: Tensor, before: Tensor, labels: Tensor) -> Tensor:
    """Return the mean divergence (nats) from an earlier network's probabilities at pixels of unknown class."""
    new, old = (functional.log_softmax(values, dim=1) for values in (logits, before))
    unknown = functional.interpolate((labels == UNKNOWN).float()[:, None], logits.shape[2:])[:, 0]
    divergence = (old.exp() * (old - new)).sum(dim=1)
    return (divergence * unknown).sum() / unknown.sum().clamp(min=1.0)


def _silhouettes(truth: Tensor) -> Tensor:
    """Pixels with a neighbour more than 30 % nearer or farther, or unknown."""
    low = -functional.max_pool2d(torch.nan_to_num(-truth, nan=torch.inf)[:, None], 3, 1, 1)[:, 0]
    high = functional.max_pool2d(torch.nan_to_num(truth, nan=torch.inf)[:, None], 3, 1, 1)[:, 0]
    return ~(high - low < 0.26)


def order_loss(log_inverse: Tensor, batch: Batch) -> Tensor:
    """Ranking loss (Chen et al. 2016) over random pairs of pixels that the teacher clearly sees at two depths."""
    values, losses = batch.inverse.flatten(1), []
    large = functional.interpolate(log_inverse, batch.inverse.shape[1:], mode="bilinear", align_corners=False)
    found = large.flatten(1)
    for index in torch.nonzero(batch.ordinal)[:, 0].tolist():
        places = torch.nonzero(torch.isfinite(values[index]))[:, 0]
        if len(places) < 2:
            continue
        # From the window's own content, not a global generator: a batch costs the same whenever it is drawn.
        generator = torch.Generator().manual_seed(len(places))
        chosen = places[torch.randint(len(places), (2, _PAIRS), generator=generator).to(places.device)]
        teacher = values[index][chosen]
        spread = torch.quantile(teacher.flatten(), 0.95) - torch.quantile(teacher.flatten(), 0.05)
        step = teacher[0] - teacher[1]
        clear = step.abs() > _CLEAR * spread
        if bool(clear.any()):
            pair = found[index][chosen]
            losses.append(functional.softplus(-torch.sign(step) * (pair[0] - pair[1]))[clear].mean())
    return torch.stack(losses).mean() if losses else log_inverse.sum() * 0.0
