"""Ablation of depth fusion: the configuration with one stage left out, for `ltm-lab eval depth --without STAGE`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ltm_core.base.errors import ConfigError
from ltm_core.depth.fusion_config import ClassLogOdds, FusionConfig

STAGES: Mapping[str, Mapping[str, Any]] = {
    "cover": {"cover.grass": 0.0, "cover.shrub": 0.0, "cover.tree": 0.0},
    "depth-dependent errors": {"error_model.by_depth": False},
    "regional errors": {"error_model.regional": False},
    "shift": {"scale.shift_gain": 0.0},
    "photo's edges for the network": {"upsampling.edge": 1e6},
    "occlusion boundaries": {"boundaries.need": 1e9},
    "outline odds": {"boundaries.outline": dict.fromkeys(ClassLogOdds.model_fields, 20.0), "boundaries.toward": 0.0},
    "labels of what stands": {"occlusion.standing": dict.fromkeys(ClassLogOdds.model_fields, 0.1)},  # that of no label
    "labels about a place": {"occlusion.about": 1},
    "height odds": {"occlusion.metre": 0.0, "occlusion.no_foot": 0.0},
    "part of the likelihood": {"decision.likelihood_weight": 1.0},
    "mean with the terrain": {"decision.agree": 0.0},
    "torn terrain": {"decision.torn": 1e9},
    "soft edges": {"decision.soft": 0.0},
    "mixtures": {"decision.open": 0.5},
}
"""By name: the constants that leave a stage out."""


def without(config: FusionConfig, stage: str) -> FusionConfig:
    """`config` with a stage left out. Raises ConfigError for a name that is none."""
    if stage not in STAGES:
        raise ConfigError(f"fusion has no stage {stage!r}; there are: {'; '.join(STAGES)}")
    return config.updated(dict(STAGES[stage]))
