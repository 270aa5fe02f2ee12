"""The gallery's photos with a pose: what was measured on real data stays within bounds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ltm_lab.evaluation.gallery.exhibit import Exhibit
from ltm_lab.evaluation.gallery.posed import Networks, engabreen_section


def _value(shown: Exhibit, name: str) -> float:
    return float(next(fact.value for fact in shown.facts if fact.name == name))


@pytest.mark.slow
def test_engabreen(shared_data: Path) -> None:
    seen: list[str] = []
    networks = Networks.open("landscape_lite0", "landscape_lite0_depth")
    section = engabreen_section(shared_data, networks, seen.append)
    assert seen == ["IMG_8902.jpg", "IMG_8937.jpg"]
    first = next(shown for shown in section.exhibits if shown.name == "IMG_8902")
    assert _value(first, "control points") == 14
    assert _value(first, "of those that the DEM does not hide, median") < 1.0
    assert _value(first, "fused depth off at control points, median") < 2.0
    # Of the pixels on ice: what is said of the mask must lie on the glacier, about a third of the picture.
    assert first.truth is not None
    assert 0.2 < (first.truth != 255).mean() < 0.5
    assert 0.0 < first.fault < 0.2
    shares = [_value(first, name) for name in ("pixels traced to terrain", "traced as unknown", "traced as sky")]
    assert np.sum(shares) == pytest.approx(1.0)
