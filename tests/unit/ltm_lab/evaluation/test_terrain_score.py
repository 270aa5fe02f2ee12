from __future__ import annotations

import numpy as np
import pytest

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.surface.config import TerrainConfig
from ltm_core.tracing import TerrainTracer
from ltm_lab.evaluation.metrics.change import ChangeScore
from ltm_lab.evaluation.terrain.frame_score import score_frames, true_depth
from ltm_lab.evaluation.terrain.hillside_scenes import Noise
from ltm_lab.evaluation.terrain.hillside_score import HillsideScore, TrialSummary
from ltm_lab.frames.truth_frames_io import TruthFrame


def scored(change: ChangeScore, before: float, after: float) -> HillsideScore:
    return HillsideScore(change, before, after, None, None)  # type: ignore[arg-type]


def test_the_worst_seed_is_told_beside_the_mean() -> None:
    nan = float("nan")
    summary = TrialSummary.of(
        [
            scored(ChangeScore(80, 20, 20, 880), 4.0, 1.0),
            scored(ChangeScore(60, 0, 40, 900), 4.0, 3.0),
            scored(ChangeScore(0, 0, 0, 1000), nan, nan),
        ]
    )
    assert summary.changed == 200
    assert (summary.precision.mean, summary.precision.worst) == pytest.approx((0.9, 0.8))
    assert (summary.recall.mean, summary.recall.worst) == pytest.approx((0.7, 0.6))
    assert (summary.false_share.mean, summary.false_share.worst) == pytest.approx((0.02 / 3, 0.02))
    assert (summary.ratio.mean, summary.ratio.worst) == pytest.approx((0.5, 0.75))
    assert (summary.rmse_before.mean, summary.rmse_after.mean) == pytest.approx((4.0, 2.0))


def test_frames_of_a_changed_landscape_are_scored_against_its_surface() -> None:
    geometry = GridGeometry(0.0, 150.0, 1.0, 200, 150)
    row, col = np.mgrid[0:150, 0:200]
    ground = Dem((300 + 0.4 * np.maximum(110 - row, 0) + np.sin(col / 17)).astype(np.float32), geometry)
    patch = (np.abs(row - 60) < 15) & (np.abs(col - 110) < 20)
    now = Dem(ground.elevation - np.float32(4) * patch, geometry)
    camera = Camera.from_fov(320, 240, 60.0)
    frames = []
    for number, (name, x, azimuth) in enumerate((("west", 70.0, 20.0), ("east", 150.0, -20.0)) * 2):
        pose = Pose.from_angles((x, 8.0, float(ground.elevation_at(x, 8.0)) + 25.0), azimuth, -6.0)
        depth = TerrainTracer(now).trace(camera, pose).depth()[::2, ::2]
        nothing = np.zeros(depth.shape, np.uint8)
        photo = np.zeros((240, 320, 3), np.uint8)
        frames.append(
            TruthFrame(name, 10**18 + number, camera, pose, photo, depth, depth, nothing, nothing.astype(bool))
        )
    config = TerrainConfig(register_frames=False)
    noise = Noise(constant=0.2, share=0.002)
    score = score_frames(frames, ground, Dem(ground.elevation.copy(), geometry), now, true_depth(noise), config)
    assert score.frames == 4
    assert score.tails[1] <= score.tails[0] < 0.02
    assert score.verdicts == {"true depth": 4}
    assert score.change.hits + score.change.misses > 200
    assert score.change.recall > 0.8
    assert score.change.precision > 0.8
    assert score.before.rmse == pytest.approx(4.0, abs=0.01)
    assert score.after.rmse < 2.0
    twice = score_frames(frames, ground, Dem(ground.elevation.copy(), geometry), now, true_depth(noise), config, 2)
    assert twice.frames == 8
    assert twice.after.rmse < 2.0
