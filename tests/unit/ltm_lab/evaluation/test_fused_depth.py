from __future__ import annotations

from dataclasses import replace

import numpy as np
from scenes.depth_scene import CAMERA, STAND_HEIGHT, depth_scene

from ltm_core.base.types import BoolArray
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import LabelSet
from ltm_lab.evaluation.depth.fused_depth import DepthEvaluation, Given, upsampled_labels
from ltm_lab.frames.truth_frames_io import TruthFrame

CLASSES = ClassPriors.of(LabelSet.load())


def frame(changed: BoolArray | None = None, step: int = 2) -> TruthFrame:
    scene = depth_scene()
    ground = TerrainTracer(scene.dem).trace(CAMERA, scene.traced.pose).depth()
    sampled = (slice(None, None, step), slice(None, None, step))
    return TruthFrame(
        "mast",
        1_700_000_000_000_000_000,
        CAMERA,
        scene.traced.pose,
        scene.photo,
        scene.truth[sampled],
        ground[sampled],
        scene.labels[sampled],
        np.zeros(scene.truth[sampled].shape, np.bool_) if changed is None else changed,
    )


def test_fused_beats_both_where_trees_stand_and_all_are_scored_on_the_same_pixels() -> None:
    scene, given = depth_scene(), frame()
    run = DepthEvaluation(0.0, scene.dem, CLASSES)
    labels = upsampled_labels(given.labels, (CAMERA.height, CAMERA.width))
    run.add(given, Given(scene.network(), labels))
    score = run.score()
    assert score.verdicts == {"ok": 1}
    counts = {row.source: row.scores[-1].pixels for row in score.rows if row.group == "all"}
    assert len(set(counts.values())) == 1
    assert score.rmse("fused", "covered") < 0.5 * score.rmse("traced", "covered")
    assert score.rmse("fused") < score.rmse("network")
    assert score.rmse("traced", "open") < 0.1
    assert np.isnan(score.rmse("traced", "changed"))
    assert score.coverage["traced"] > 0.99


def test_a_raster_of_what_stood_is_scored_and_fused_too() -> None:
    """Where its stand still stands it is right, where that is gone it is wrong; fused depth is near the better."""
    scene, given = depth_scene(), frame()
    rows, cols = np.mgrid[0 : scene.dem.geometry.height, 0 : scene.dem.geometry.width]
    x, y = scene.dem.geometry.to_map(rows, cols)
    stood = (np.abs(x - 60.0) < 70.0) & (np.abs(y - 330.0) < 45.0)
    felled = (np.abs(x + 120.0) < 40.0) & (np.abs(y - 330.0) < 45.0)
    tops = scene.dem.elevation + np.float32(STAND_HEIGHT) * (stood | felled)
    run = DepthEvaluation(0.0, scene.dem, CLASSES, surface=replace(scene.dem, elevation=tops))
    with np.errstate(invalid="ignore"):
        gone = TerrainTracer(replace(scene.dem, elevation=tops)).trace(CAMERA, scene.traced.pose).depth()[::2, ::2]
        gone = np.isfinite(given.surface) & (gone < 0.95 * given.surface) & (given.surface == given.ground)
    assert gone.sum() > 500
    changed = frame(gone)
    labels = upsampled_labels(given.labels, (CAMERA.height, CAMERA.width))
    run.add(changed, Given(scene.network(), labels))
    score = run.score()
    assert [row.source for row in score.rows if row.group == "all"] == ["traced", "surface", "network", "fused"]
    assert score.rmse("surface", "covered") < 0.2 * score.rmse("traced", "covered")
    assert score.rmse("traced", "changed") < 0.2 * score.rmse("surface", "changed")
    for group in ("covered", "changed", "covered or changed"):
        worst = max(score.rmse("traced", group), score.rmse("surface", group))
        assert score.rmse("fused", group) < 0.35 * worst
    parts = [row.scores[-1].pixels for row in score.rows if row.source == "fused"]
    assert parts[-1] == parts[2] + parts[3]  # covered or changed; here no pixel is both
