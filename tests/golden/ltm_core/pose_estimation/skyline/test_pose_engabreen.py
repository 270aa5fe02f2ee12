"""A real photo whose far mountains lie outside the DEM: its pose by ridges alone, beside that of its control points."""

from pathlib import Path

import numpy as np
import pytest

from ltm_core.vision.segmenter import Segmenter
from ltm_lab.evaluation.pose.engabreen_io import STARTS, read_real_photo, run_real_trials


@pytest.mark.slow
def test_ridges_find_the_control_points_pose_from_far_off(shared_data: Path) -> None:
    real = read_real_photo(shared_data / "engabreen")
    trials = run_real_trials(real, Segmenter.open().segment(real.photo).labels)
    errors = np.abs([trial.error for trial in trials])
    print(f"{STARTS} starts; {np.median(errors, axis=0)}, at most {errors.max(axis=0)}")
    assert (errors < (0.12, 0.1, 0.32)).all(), errors
    assert (errors < (0.1, 0.1, 0.3)).all(axis=1).sum() >= 11, "which is asked of all"
    assert np.median([trial.median for trial in trials]) < 3.0, "metres on the ground"
    assert sum(trial.verdict == "accepted" for trial in trials) >= 10
