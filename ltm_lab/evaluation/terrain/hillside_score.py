"""Run the surface map on an exact hillside scene, score it, and summarise scores over seeds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np

from ltm_core.base.types import BoolArray
from ltm_core.surface.config import TerrainConfig
from ltm_core.surface.layers import SurfaceLayers
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.surface_map import SurfaceMap
from ltm_lab.evaluation.metrics.change import ChangeScore, score_change
from ltm_lab.evaluation.metrics.heights import score_surface
from ltm_lab.evaluation.terrain.hillside_ground import TOWERS
from ltm_lab.evaluation.terrain.hillside_scenes import SceneConditions, frames, trial


@dataclass(frozen=True, eq=False)
class HillsideScore:
    """The score of one run.

    `change` counts the cells that independent views have seen; a cell has changed if its true surface differs from the
    given one by the map's threshold or more (`truth`). The RMSE is that of the surface on the changed cells, metres."""

    change: ChangeScore
    rmse_before: float
    rmse_after: float
    layers: SurfaceLayers
    truth: BoolArray

    @property
    def false_share(self) -> float:
        """The share of the seen cells that are wrongly reported as changed."""
        return self.change.false_alarms / max(self.change.cells, 1)


def score_trial(name: str, conditions: SceneConditions) -> HillsideScore:
    """Add the towers' frames of a scene to a surface map, and score it. Raises ConfigError for an unknown scene."""
    # The noise is normal, and its repeated share is known, as its sigma is.
    config = TerrainConfig()
    config = config.model_copy(update={"repeated_error_share": conditions.noise.repeats, "alone": config.confidence})
    scene = trial(name, conditions.seed)
    surface = SurfaceMap(Reference.of(scene.bare, scene.given), config, tuple(TOWERS))
    for frame in frames(scene, conditions):
        surface.add(frame)
    surface.decide()
    layers, now = surface.layers(), scene.true_now.elevation
    truth = np.abs(now - scene.given.elevation) >= config.threshold
    seen = truth & layers.observed
    return HillsideScore(
        score_change(layers.change > 0, truth, layers.observed),
        score_surface(scene.given.elevation, now, seen).rmse,
        score_surface(layers.height, now, seen).rmse,
        layers,
        truth,
    )


@dataclass(frozen=True)
class Spread:
    """The mean and the worst value over seeds; NaN if no seed has a value."""

    mean: float
    worst: float

    @classmethod
    def of(cls, values: Sequence[float], worst: Callable[[Sequence[float]], float]) -> "Spread":
        """Summarise the values that are not NaN."""
        known = [value for value in values if value == value]
        return cls(fmean(known), worst(known)) if known else cls(float("nan"), float("nan"))


@dataclass(frozen=True)
class TrialSummary:
    """Scores over seeds. `changed` counts the changed cells that were seen, of all seeds; `ratio` is the RMSE after the
    update over that before."""

    changed: int
    precision: Spread
    recall: Spread
    false_share: Spread
    rmse_before: Spread
    rmse_after: Spread
    ratio: Spread

    @classmethod
    def of(cls, scores: Sequence[HillsideScore]) -> "TrialSummary":
        """Summarise one score or more."""
        return cls(
            sum(score.change.hits + score.change.misses for score in scores),
            Spread.of([score.change.precision for score in scores], min),
            Spread.of([score.change.recall for score in scores], min),
            Spread.of([score.false_share for score in scores], max),
            Spread.of([score.rmse_before for score in scores], max),
            Spread.of([score.rmse_after for score in scores], max),
            Spread.of([score.rmse_after / score.rmse_before for score in scores], max),
        )
