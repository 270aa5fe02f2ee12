"""What stands before the camera and over it: cameras under ground, clouds, smoke."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from small_scenario import CAMERA, small_scenario

pytest.importorskip("mitsuba", reason="needs the extra `sim`: pip install 'ltm[sim]'")

from ltm_core.errors import ConfigError
from ltm_core.pose import Pose
from ltm_core.simulator.run import SimulatedSite, make_site, plan_shots, render_shots, site_at
from ltm_core.simulator.scenario import Scenario
from ltm_core.simulator.weather import Clouds, smoke


def scenario(**changes: Any) -> Scenario:
    return small_scenario(**({"cameras": [CAMERA]} | changes))


CONFIG = scenario()


@pytest.fixture(scope="module")
def site() -> SimulatedSite:
    return make_site(CONFIG)


def test_cameras_under_ground_are_refused(site: SimulatedSite) -> None:
    low = scenario(cameras=[{"name": "a", "x": 120.0, "y": 90.0, "z": 100.0, "patrol": {"azimuth_deg": [40.0]}}])
    with pytest.raises(ConfigError, match=r"cameras\.0: a stands at 100.00 m, \d+\.\d+ m under the ground.*mast"):
        plan_shots(low, site)
    filled = scenario(
        changes=[{"kind": "cut", "depth": -40.0, "mask": {"circle": [120, 90, 40]}, "years": 1.0}],
    )
    dated = site_at(filled, site, filled.dates[1])
    with pytest.raises(ConfigError, match=r"camera a is .* m under the ground that changes up to after leave"):
        next(iter(render_shots(filled, dated, plan_shots(filled, site, filled.dates[1]))))


def test_clouds_cover_their_share_and_shade_the_ground_below() -> None:
    config = scenario(clouds={"cover": 0.4, "base": 1000.0, "size": 900.0})
    assert config.clouds is not None
    clouds = Clouds(config.clouds, 300.0, config.sun, 4)
    x, y = np.meshgrid(np.arange(0, 20_000, 90.0), np.arange(0, 15_000, 90.0))
    thick = clouds.thickness(x, y)
    assert np.mean(thick > 0.5) == pytest.approx(0.4, abs=0.05)
    points = np.stack([x, y, np.full(x.shape, 300.0)], axis=-1)
    light = clouds.sunlight(points)
    assert 0.2 < light.min() < 0.3 < 0.99 < light.max()
    # The shadow lies opposite the sun
    tan, azimuth = np.tan(np.radians(config.sun.elevation_deg)), np.radians(config.sun.azimuth_deg)
    shifted = clouds.thickness(x + 1000 / tan * np.sin(azimuth), y + 1000 / tan * np.cos(azimuth))
    np.testing.assert_allclose(light, 1 - 0.78 * shifted, atol=1e-5)


def test_smoke_rises_with_the_wind_and_hides_only_what_is_behind_it() -> None:
    config = scenario(smoke=[{"x": 0.0, "y": 500.0, "wind_deg": 90.0, "height": 120.0, "drift": 150.0}])
    camera, pose = config.camera_model(60.0), Pose.from_angles((0.0, 0.0, 40.0), 0.0, 4.0)
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
