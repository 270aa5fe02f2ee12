"""Depth measured by a network alone, with its uncertainty, to detect changes of the terrain: fused depth follows it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ltm_core.base.kernels import kernel
from ltm_core.base.types import BoolArray, Float32Array
from ltm_core.depth.error_model import ErrorModel, invert
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.pixel_fusion import DecisionRules, elsewhere
from ltm_core.depth.scale_fit import ScaleFit
from ltm_core.depth.unseen_terrain import hidden_at


@dataclass(frozen=True, eq=False)
class NetworkMeasurement:
    """Depth measured by a network. `depth`, `sigma`: (h, w) float32 metres along the optical axis, at the network's own
    size, edge to edge over the photo; NaN where nothing is measured."""

    depth: Float32Array
    sigma: Float32Array


def measured(fit: ScaleFit | None, config: FusionConfig, unseen: Sequence[BoolArray]) -> NetworkMeasurement:
    """Return the measurement of a usable fit, empty without one. A pixel may not show the ground on which the network
    was fitted, so sigma is that of objects in front of it. `unseen`: pixels that do not show the terrain, at any size,
    edge to edge."""
    height, width = (1, 1) if fit is None else fit.inverse.shape
    depth, sigma = (np.full((height, width), np.nan, np.float32) for _ in range(2))
    if fit is not None:
        seen, sure = (fit.inverse, fit.nearest, fit.farthest), np.float32(config.decision.measured)
        _measure(seen, fit.error_model, DecisionRules.of(config.decision), sure, depth, sigma)
    for hidden in unseen:
        gone = hidden_at(hidden, height, width)
        depth[gone] = sigma[gone] = np.nan
    return NetworkMeasurement(depth, sigma)


@kernel(nogil=True)
def _measure(
    seen: tuple[Float32Array, Float32Array, Float32Array],
    errors: ErrorModel,
    rules: DecisionRules,
    sure: np.float32,
    depth: Float32Array,
    sigma: Float32Array,
) -> None:
    """`seen`: (h, w) each, what the network sees, and the greatest and least among neighbours; `sure`: relative sigma
    from which on a depth measures nothing."""
    inverse, nearest, farthest = seen
    height, width = inverse.shape
    one, none = np.float32(1.0), np.float32(np.nan)
    for v in range(height):
        for u in range(width):
            depth[v, u], sigma[v, u] = none, none
            if inverse[v, u] > 0:
                true, t = invert(inverse[v, u], errors)
                t = elsewhere(t, nearest[v, u], farthest[v, u], rules)
                if t < sure * true:
                    depth[v, u], sigma[v, u] = one / true, t / (true * true)
