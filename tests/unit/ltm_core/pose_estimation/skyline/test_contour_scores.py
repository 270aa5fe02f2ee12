"""Scores of ridges on edges, and what chance gives."""

from __future__ import annotations

import numpy as np
import pytest

from ltm_core.pose_estimation.skyline.contour_scores import usual_score


def test_the_usual_score_is_the_median_with_its_robust_deviation() -> None:
    scores = np.random.default_rng(3).normal(4.0, 2.5, 4000)
    scores[:200] = 90.0  # some poses that fit
    middle, spread = usual_score(scores)
    assert middle == pytest.approx(4.2, abs=0.2)
    assert spread == pytest.approx(2.6, abs=0.2)


def test_where_hardly_a_pose_sees_a_ridge_one_that_does_does_not_stand_out_for_that_alone() -> None:
    scores = np.zeros(97)
    scores[60:63] = 0.5, 0.8, 0.6  # a ridge of a few points at the edge of the picture
    middle, spread = usual_score(scores)
    assert middle == 0.0
    assert ((scores - middle) / spread).max() < 1.5
