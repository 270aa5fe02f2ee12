import numpy as np
import pytest
from scenes.mountain_view import eye, mountains, terrain, view

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.pose_prior import angles_between
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND
from ltm_lab.evaluation.pose.pose_trial import PoseScore, PoseTrial, Sensor, disturbed, run_trial
from ltm_lab.evaluation.pose.rendered_terrain_io import PreparedFrame, prepared
from ltm_lab.frames.truth_frames_io import TruthFrame

SMALL = Camera.from_fov(320, 200, 50.0)


def frame(azimuth: float) -> PreparedFrame:
    pose = Pose.from_angles(eye(), azimuth, 1.5, 0.5)
    photo, labels = view(pose, SMALL)
    depth = TerrainTracer(mountains(), possible=NOTHING_BEYOND).trace(SMALL, pose).depth()
    truth = TruthFrame("mast", 0, SMALL, pose, photo, depth, depth, labels, np.zeros(labels.shape, np.bool_))
    return prepared(0, truth, labels, terrain())


def test_a_trial_says_how_far_pose_and_places_are_off() -> None:
    tracer = TerrainTracer(mountains(), possible=NOTHING_BEYOND)
    rng = np.random.default_rng(11)
    trial = run_trial(frame(75.0), Sensor.mount, terrain(), tracer, rng)
    assert trial.accepted
    assert trial.open_share == 0.0
    true = Pose.from_angles(eye(), 75.0, 1.5, 0.5)
    prior = disturbed(true, Sensor.mount, mountains(), np.random.default_rng(11))
    np.testing.assert_allclose(trial.before, np.degrees(angles_between(true, prior.pose)), atol=1e-9)
    assert np.abs(trial.after).max() < 0.15
    assert trial.traced < trial.traced_before


def trial_of(azimuth: float, verdict: str = "accepted", open_share: float = 0.0) -> PoseTrial:
    off = (azimuth, 0.1, -0.2)
    z = (azimuth / 0.5, 1.0, 1.0)
    return PoseTrial(
        "f", Sensor.mount, verdict, (1.5, 0, 0), off, z, 9.0, 0.9, open_share, 25.0, 4.0, 1.01, 0.3
    )  # fmt: skip


def test_only_accepted_poses_count_as_wrong() -> None:
    trials = [trial_of(0.2), trial_of(-1.5), trial_of(2.5), trial_of(30.0, "ambiguous"), trial_of(0.1, open_share=0.8)]
    scores = PoseScore.by_view(trials)
    score = scores["inside, mount"]
    assert (score.trials, score.accepted) == (4, 3)
    assert (score.wrong_by_1, score.wrong_by_2) == (2, 1)
    assert score.angles[0].median == pytest.approx(1.5)
    assert score.angles[0].greatest == pytest.approx(2.5)
    assert score.z[0] == pytest.approx(1.4826 * 3.0)
    assert score.verdicts == {"accepted": 3, "ambiguous": 1}
    assert score.focal_percent.median == pytest.approx(1.0)
    assert scores.keys() == {"inside, mount", "open, mount"}
    assert scores["open, mount"].trials == 1
