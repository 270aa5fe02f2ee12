"""Runs the surface map on one exact hillside scene and scores it."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt

from ltm_core.surface.config import TerrainConfig
from ltm_core.surface.layers import SurfaceLayers
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.surface_map import SurfaceMap
from ltm_lab.evaluation.metrics.change import ChangeScore, score_change
from ltm_lab.evaluation.metrics.heights import score_surface
from ltm_lab.evaluation.terrain.hillside_ground import TOWERS
from ltm_lab.evaluation.terrain.hillside_scenes import HillsideScene, SceneConditions, frames, trial

BESIDE = 3.0
"""Cells of 1 m: what is found so near to a true change is that change, a little off or with its gaps closed."""


@dataclass(frozen=True, eq=False)
class HillsideScore:
    """What a scene gave. `change`: by cell, of the cells that independent views have seen; true change is a
    difference of at least the map's threshold between the surface as given and as it is. `away`: falsely changed cells
    that are not beside a true change, but more than BESIDE from any. `covered`: share of truly
    changed cells that were seen. `rmse`: of the surface on those, before and after. `frame_ms`, `decide_ms`: median
    processor time.
    """

    scene: str
    conditions: SceneConditions
    change: ChangeScore
    away: int
    covered: float
    rmse_before: float
    rmse_after: float
    frame_ms: float
    decide_ms: float
    trial: HillsideScene
    layers: SurfaceLayers

    @property
    def false_share(self) -> float:
        """Falsely changed cells of all that were seen."""
        return self.change.false_alarms / max(self.change.cells, 1)

    @property
    def away_share(self) -> float:
        """Falsely changed cells beside no true change, of all that were seen."""
        return self.away / max(self.change.cells, 1)

    def row(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "scene": self.scene,
            "conditions": asdict(self.conditions),
            "seen_cells": self.change.cells,
            "truly_changed_seen": self.change.hits + self.change.misses,
            "covered": _number(self.covered),
            "precision": _number(self.change.precision),
            "recall": _number(self.change.recall),
            "false_share": self.false_share,
            "false_away_share": self.away_share,
            "rmse_before_m": _number(self.rmse_before),
            "rmse_after_m": _number(self.rmse_after),
            "frame_cpu_ms": self.frame_ms,
            "decide_cpu_ms": self.decide_ms,
        }


def score_trial(name: str, conditions: SceneConditions, config: TerrainConfig | None = None) -> HillsideScore:
    """Let the towers look at a scene, and compare. Raises ConfigError for an unknown scene."""
    config = config or TerrainConfig()
    # Trials make those pixels only that the map would take of a whole image. The map is told, as it is of sigma, what
    # of the noise each look repeats, and that it has a normal distribution's tails.
    told = {"repeated_error_share": conditions.noise.repeats, "alone": config.confidence}
    config = config.model_copy(update=told)
    scene = trial(name, conditions.seed)
    surface = SurfaceMap(Reference.of(scene.bare, scene.given), config, tuple(TOWERS))
    costs = []
    for frame in frames(scene, conditions):
        begun = time.process_time()
        surface.add(frame)
        costs.append(time.process_time() - begun)
    begun = time.process_time()
    surface.decide()
    decided = time.process_time() - begun
    layers = surface.layers()
    truth = np.abs(scene.true_now.elevation - scene.given.elevation) >= config.threshold
    seen = truth & layers.observed
    away = (layers.change > 0) & layers.observed & (distance_transform_edt(~truth) > BESIDE)
    return HillsideScore(
        name,
        conditions,
        score_change(layers.change > 0, truth, layers.observed),
        int(away.sum()) if truth.any() else int((layers.change > 0)[layers.observed].sum()),
        float(seen.sum() / truth.sum()) if truth.any() else float("nan"),
        score_surface(scene.given.elevation, scene.true_now.elevation, seen).rmse,
        score_surface(layers.height, scene.true_now.elevation, seen).rmse,
        1e3 * float(np.median(costs)),
        1e3 * decided,
        scene,
        layers,
    )


def _number(value: float) -> float | None:
    return None if value != value else value
