"""A real camera over a sandbar, whose later surveys tell what has changed since the one that the map starts from."""

from pathlib import Path

import numpy as np

from ltm_lab.evaluation.terrain.canyon_io import read_canyon
from ltm_lab.evaluation.terrain.canyon_score import score_canyon


def test_the_later_survey_is_approached_where_depth_is_good(shared_data: Path) -> None:
    canyon = read_canyon(shared_data / "grandcanyon_rm22")
    fit = canyon.resection
    print(f"resection: median {np.median(fit.residual_px):.0f} px of {len(fit.points.names)} points, {fit.sigmas}")
    # What the source's own author reached with these points: median 66 px.
    assert np.median(fit.residual_px) < 66
    score = score_canyon(canyon, None)
    print(score.change, score.before, score.after)
    assert score.change.cells > 1000
    assert score.change.precision > 0.8
    assert score.change.recall > 0.7
    assert score.after.rmse < score.before.rmse
