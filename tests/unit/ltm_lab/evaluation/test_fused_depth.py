"""Scores of depth under errors put in on purpose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes.depth_scene import CAMERA, STAND_HEIGHT, depth_scene

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import BoolArray
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.monocular import NetworkDepth
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import LabelSet
from ltm_lab.evaluation.depth.fused_depth import BEYOND, DepthEvaluation, Given, upsampled_labels
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
    assert [row.source for row in score.rows if row.group == "all"] == [
        "traced",
        "surface",
        "aligned",
        "network",
        "fused",
    ]
    assert score.rmse("surface", "covered") < 0.2 * score.rmse("traced", "covered")
    assert score.rmse("traced", "changed") < 0.2 * score.rmse("surface", "changed")
    for group in ("covered", "changed", "covered or changed"):
        worst = max(score.rmse("traced", group), score.rmse("surface", group))
        assert score.rmse("fused", group) < 0.35 * worst
    parts = [row.scores[-1].pixels for row in score.rows if row.source == "fused"]
    assert parts[4] == parts[2] + parts[3]  # covered or changed; here no pixel is both


def test_metric_depth_is_scored_as_given_and_scaled_to_the_truth() -> None:
    scene, given = depth_scene(), frame()
    far = np.isfinite(scene.truth) & (scene.truth > 100.0)
    metres = np.where(np.isfinite(scene.truth), scene.truth / 2, np.nan).astype(np.float32)
    run = DepthEvaluation(0.0, scene.dem, CLASSES)
    run.add(given, Given(NetworkDepth(metres, "metric"), None))
    score = run.score()
    truth = scene.truth[::2, ::2][far[::2, ::2]]
    assert score.rmse("metric", BEYOND) == pytest.approx(np.sqrt(np.mean((truth / 2) ** 2)), rel=0.05)
    assert score.rmse("aligned") == pytest.approx(0.0, abs=1e-2)


def test_a_negative_pose_error_is_rejected() -> None:
    with pytest.raises(ConfigError, match="-1"):
        DepthEvaluation(-1.0, depth_scene().dem, CLASSES)


def test_a_wrong_pose_is_counted_and_changes_nothing_else() -> None:
    scene, given = depth_scene(), frame()
    run = DepthEvaluation(2.0, scene.dem, CLASSES)
    run.add(given, Given(scene.network(), scene.labels))
    score = run.score()
    assert score.verdicts == {"pose_suspected": 1}
    assert score.rmse("fused") == pytest.approx(score.rmse("traced"))
