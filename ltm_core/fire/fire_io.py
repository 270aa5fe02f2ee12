"""Writes fires as GeoTIFF."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ltm_core.fire.effect import FireEffect
from ltm_core.fuel.export.landscape_io import write_raster
from ltm_core.grid import GridGeometry

BANDS: Mapping[str, str] = {
    "arrival_before": "hours after ignition",
    "arrival_after": "hours after ignition",
    "arrival_difference": "hours, positive: later on the map as it is",
    "flame_before": "m",
    "flame_after": "m",
    "flame_difference": "m, positive: longer on the map as it is",
    "changed": "0 no, 1 yes",
    "burn_probability": "1",
}
"""Name and unit of each band; the last one only of an ensemble."""


def write_fire(path: Path, effect: FireEffect, geometry: GridGeometry, tags: Mapping[str, str]) -> None:
    """One GeoTIFF of float32 bands, NaN where the fire does not come. Raises ConfigError where it cannot be written."""
    layers = [
        effect.before.arrival,
        effect.after.arrival,
        effect.difference(),
        np.where(effect.before.burned, effect.before.flame, np.nan),
        np.where(effect.after.burned, effect.after.flame, np.nan),
        effect.flame_difference(),
        effect.changed,
    ]
    if effect.probability is not None:
        layers.append(effect.probability)
    count = len(layers)
    array = np.stack([np.asarray(layer, np.float32) for layer in layers])
    names, units = tuple(BANDS)[:count], tuple(BANDS.values())[:count]
    write_raster(path, array, geometry, float("nan"), names, units, tags=tags)
