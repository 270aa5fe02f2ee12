from typing import Any

import numpy as np
import pytest
from scenes.small_scenario import CAMERA, small_scenario

pytest.importorskip("mitsuba", reason="needs the extra `sim`: pip install './ltm_lab[sim]'")

from ltm_core.geometry.pose import Pose
from ltm_lab.simulator.imaging import smoke
from ltm_lab.simulator.scenario import Scenario


def scenario(**changes: Any) -> Scenario:
    return small_scenario(**({"cameras": [CAMERA]} | changes))


def test_smoke_rises_with_the_wind_and_hides_only_what_is_behind_it() -> None:
    config = scenario(smoke=[{"x": 60.0, "y": 390.0, "wind_deg": 90.0, "height": 120.0, "drift": 150.0}])
    camera, pose = config.camera_model(60.0), Pose.from_angles((60.0, 0.0, 40.0), 0.0, 4.0)
    far, near = (np.full((80, 120), r, np.float32) for r in (5000.0, 200.0))
    light, alpha = smoke(config.smoke, [0.0], camera, pose, far, 1.0, 3)
    assert alpha.max() > 0.6
    assert 0 <= alpha.min() <= alpha.max() <= 1
    rows, cols = np.nonzero(alpha > 0.3)
    assert cols.mean() > 62, "the wind blows to the right"
    low, high = rows > rows.mean(), rows < rows.mean()
    assert cols[high].mean() > cols[low].mean()
    assert np.all(light.max(axis=-1) <= alpha + 1e-6)
    assert not smoke(config.smoke, [0.0], camera, pose, near, 1.0, 3)[1].any()
