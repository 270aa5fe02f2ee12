import numpy as np
from scenes.depth_scene import CAMERA, depth_scene

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
