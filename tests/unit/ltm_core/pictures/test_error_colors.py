"""Colours of depth errors."""

from __future__ import annotations

import numpy as np

from ltm_core.pictures.legend import SKY_COLOR, error_colors, error_legend


def test_error_colors() -> None:
    truth = np.array([[10.0, 10.0, np.inf, np.inf, 10.0]], np.float32)
    estimate = np.array([[10.1, 310.0, np.inf, 50.0, np.nan]], np.float32)
    small, large, sky, missed, unknown = error_colors(estimate, truth)[0].astype(int)
    assert small.sum() < 60 < 400 < large.sum()
    assert tuple(sky) == SKY_COLOR
    assert tuple(missed) == tuple(unknown) == (190, 192, 196)
    assert error_legend(400).shape[1] == 400
