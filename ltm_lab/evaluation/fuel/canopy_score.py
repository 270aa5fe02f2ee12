"""Scores the canopy of fuel cells whose surface was confirmed to have changed, in exact hillside scenes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ltm_core.base.types import Float32Array
from ltm_core.fuel.canopy import TALL, measured_canopy, seen_canopy
from ltm_core.fuel.codes import TreeCanopy
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.votes import VoteCaster
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.surface import Reference, SurfaceMap
from ltm_core.surface.config import TerrainConfig
from ltm_core.surface.confirmed_surface import ConfirmedSurface, confirmed_surface
from ltm_core.surface.confirmed_terrain import ConfirmedTerrain
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import LabelSet
from ltm_lab.evaluation.terrain.hillside_ground import GEOMETRY, TOWERS
from ltm_lab.evaluation.terrain.hillside_scenes import HillsideScene, SceneConditions, frames

FUEL_CELL = 30
"""Metres, and cells of the scenes' rasters."""
_LEAST_COVER = 10.0
"""% of true canopy that a cell needs for a height."""

_SHRUBS = 0.5
"""Metres from which on what stands lower than trees is called shrub."""
_WRONG = 0.1
"""Share of the pixels whose label is drawn from grass, shrub and tree."""

Source = Literal["seen", "surface alone", "as given", "constant"]


@dataclass(frozen=True)
class CanopyScore:
    """Of `cells` whose change was confirmed: the median error of cover in points, and of height as a share of the true
    one over the `wooded` of them.
    """

    source: Source
    cells: int
    wooded: int
    cover: float
    height: float


def confirmed_of(scene: HillsideScene, conditions: SceneConditions) -> ConfirmedSurface:
    """What the towers' measurements of a scene confirm."""
    # Errors of these depths are new in most looks, and normal.
    config = TerrainConfig(repeated_error_share=conditions.noise.repeats, alone=3.0)
    surface = SurfaceMap(Reference.of(scene.bare, scene.given), config, tuple(TOWERS))
    for frame in frames(scene, conditions):
        surface.add(frame)
    surface.decide()
    return confirmed_surface(surface)[0]


def labels_of(
    scene: HillsideScene, confirmed: ConfirmedSurface, conditions: SceneConditions, grid: GridGeometry
) -> EvidenceMap:
    """What labels of the towers' images show of the cells of `grid`, voted where sight meets the confirmed surface.
    They are those of what truly stands, but for one pixel in ten.
    """
    names, rng = LabelSet.load(), np.random.default_rng(conditions.seed)
    ids = np.array([names.names.index(name) for name in ("grass", "shrub", "tree")], np.uint8)
    caster = VoteCaster(grid, scene.bare, np.array(names.ground_cover))
    traced, true = (TerrainTracer(dem) for dem in (confirmed.surface_over(scene.given), scene.true_now))
    evidence = EvidenceMap(grid, None, names)
    for frame in frames(scene, conditions):
        points = true.trace(frame.camera, frame.pose).points().reshape(-1, 3).astype(np.float64)
        x, y = (np.where(np.isfinite(points[:, i]), points[:, i], 0.0) for i in (0, 1))
        above = scene.true_now.elevation_at(x, y) - scene.bare.elevation_at(x, y)
        labels = ids[np.searchsorted([_SHRUBS, TALL], np.nan_to_num(above), side="right")]
        wrong = rng.random(len(labels)) < _WRONG
        labels[wrong] = rng.choice(ids, int(wrong.sum()))
        depth = traced.trace(frame.camera, frame.pose).depth()
        shown = labels.reshape(depth.shape)
        evidence.add(caster.cast(depth, frame.camera, frame.pose, shown, frame.stamp_ns, frame.source))
    return evidence


def score_canopy(
    scene: HillsideScene,
    confirmed: ConfirmedSurface,
    constant: TreeCanopy,
    conditions: SceneConditions | None = None,
) -> list[CanopyScore]:
    """Of what is seen, by the confirmed surface and, where `conditions` of the frames are given, by labels; of the
    surface alone; of that as it was given, and of a climate's `constant` for new trees; empty where nothing was
    confirmed.
    """
    rows, cols = (n // FUEL_CELL for n in GEOMETRY.shape)
    grid = GridGeometry(GEOMETRY.x_min, GEOMETRY.y_max, float(FUEL_CELL), cols, rows)
    top, ground = confirmed.surface_over(scene.given), confirmed.ground_over(scene.bare)
    alone = seen_canopy(ConfirmedTerrain(None, ground, top, confirmed, given=scene.given), grid)
    if alone is None:
        return []
    cells = np.isfinite(alone.cover)
    true_cover, true_height = _blocks(scene.true_now, scene.bare, grid)
    given_cover, given_height = _blocks(scene.given, scene.bare, grid)
    seen = alone
    if conditions is not None:
        before = np.where(given_cover > 0, given_cover, np.nan).astype(np.float64)
        labels = labels_of(scene, confirmed, conditions, grid).label_cover(before)
        seen = measured_canopy(given_cover > 0, np.zeros(cells.shape, np.bool_), alone, labels, None)
    wooded = cells & (true_cover >= _LEAST_COVER)
    flat = np.ones_like(seen.cover)
    sources: Iterable[tuple[Source, Float32Array, Float32Array]] = (
        ("seen", seen.cover, seen.height),
        ("surface alone", alone.cover, alone.height),
        ("as given", given_cover, given_height),
        ("constant", flat * np.float32(constant.cover), flat * np.float32(constant.height)),
    )
    scores = []
    for source, cover, height in sources:
        off = np.abs(height - true_height)[wooded] / true_height[wooded]
        scores.append(
            CanopyScore(
                source,
                int(cells.sum()),
                int(wooded.sum()),
                float(np.median(np.abs(cover - true_cover)[cells])) if cells.any() else float("nan"),
                float(np.median(off)) if wooded.any() else float("nan"),
            )
        )
    return scores


def _blocks(top: Dem, ground: Dem, grid: GridGeometry) -> tuple[Float32Array, Float32Array]:
    """True cover (%) and mean height (m) of the canopy in each fuel cell, from each metre of it."""
    height, width = grid.height * FUEL_CELL, grid.width * FUEL_CELL
    above = (top.elevation - ground.elevation)[:height, :width]
    blocks = above.reshape(grid.height, FUEL_CELL, grid.width, FUEL_CELL)
    canopy = blocks >= TALL
    stands = canopy.sum(axis=(1, 3))
    mean = np.where(canopy, blocks, 0).sum(axis=(1, 3)) / np.maximum(stands, 1)
    return (100 * stands / FUEL_CELL**2).astype(np.float32), mean.astype(np.float32)
