"""What stands before the camera and over it: cameras under ground, clouds, smoke."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes.small_scenario import CAMERA, small_scenario

pytest.importorskip("mitsuba", reason="needs the extra `sim`: pip install 'ltm[sim]'")

from ltm_core.base.errors import ConfigError
from ltm_core.geometry.pose import Pose
from ltm_lab.simulator.clouds import Clouds
from ltm_lab.simulator.run import SimulatedSite, make_site, plan_shots, render_shots, site_at
from ltm_lab.simulator.scenario import CloudConfig, Scenario
from ltm_lab.simulator.weather import smoke


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


def sky(seed: int = 4, eye: tuple[float, float, float] = (120.0, 90.0, 330.0), **clouds: Any) -> Clouds:
    config = CloudConfig(**({"cover": 0.4, "base": 1000.0, "depth": 500.0, "size": 1500.0} | clouds))
    return Clouds(config, 300.0, CONFIG.sun, np.array(eye), seed)


def test_clouds_form_over_their_share_of_the_map() -> None:
    x, y = np.meshgrid(np.arange(0, 60_000, 410.0), np.arange(0, 45_000, 410.0))
    for cover in (0.15, 0.4, 0.9):
        assert np.mean(sky(cover=cover).strength(x, y) > 0) == pytest.approx(cover, abs=0.05)
    assert np.all(sky(cover=0.0).strength(x, y) < 0)
    assert np.mean(sky(cover=1.0).strength(x, y) > 0) > 0.999


def test_shadows_lie_opposite_the_sun() -> None:
    clouds = sky()
    x, y = np.meshgrid(np.arange(0, 6000, 90.0), np.arange(0, 4000, 90.0))
    light = clouds.sunlight(np.stack([x, y, np.full(x.shape, 300.0)], axis=-1))
    assert light.min() == pytest.approx(0.03, abs=0.02), "what a thick cloud leaves"
    assert light.max() == 1.0
    # A sunray climbs to the middle of the slab, 1250 m up, while it goes so far towards the sun
    tan, azimuth = np.tan(np.radians(CONFIG.sun.elevation_deg)), np.radians(CONFIG.sun.azimuth_deg)
    along = np.array([np.sin(azimuth), np.cos(azimuth)]) * 1250.0 / tan
    there, here = clouds.strength(x + along[0], y + along[1]), clouds.strength(x, y)
    assert np.corrcoef(light.ravel(), np.clip(there, 0, 1).ravel())[0, 1] < -0.7
    assert abs(np.corrcoef(light.ravel(), np.clip(here, 0, 1).ravel())[0, 1]) < 0.4
    # Ground above the clouds is in the sun
    assert sky().sunlight(np.array([[500.0, 500.0, 1900.0]]))[0] == 1.0


def test_clouds_are_soft_bodies_with_dark_bases_above_the_horizon() -> None:
    camera, clouds = CONFIG.camera_model(70.0), sky(cover=0.55)
    layer = clouds.seen(camera, Pose.from_angles((120.0, 90.0, 330.0), 30.0, 12.0))
    opacity = layer.opacity
    assert opacity.shape == (80, 120)
    assert 0 <= opacity.min() <= opacity.max() <= 1
    assert np.mean((opacity > 0.02) & (opacity < 0.6)) > 0.1, "edges thin out"
    level = 40 + camera.fy * np.tan(np.radians(12.0))
    assert not opacity[int(level) + 5 :].any(), "nothing below the horizon"
    assert np.all(layer.sun[opacity == 0] == 0)
    assert np.all(layer.sky <= opacity + 1e-6)
    # Seen from straight below a cloud shows its base, from straight above its sunlit top
    below = clouds.seen(camera, Pose.from_angles((120.0, 90.0, 330.0), 0.0, 89.0))
    body = below.opacity > 0.9
    assert body.any()
    assert np.mean(below.sun[body]) < 0.75 * layer.sun[opacity > 0.5].max()


def test_an_overcast_takes_the_sun_and_greys_the_light() -> None:
    sun, blue = np.array([0.3, 0.28, 0.25], np.float32), np.array([0.05, 0.08, 0.13], np.float32)
    clear = sky(cover=0.0).overhead(sun, blue)
    assert clear.cover == 0
    np.testing.assert_allclose(clear.factor, 1.0, rtol=1e-6)
    np.testing.assert_allclose(clear.air(blue), blue, rtol=1e-6)
    grey = sky(cover=1.0, kind="stratus", depth=900.0)
    points = np.stack(
        [*np.meshgrid(np.arange(0, 4000, 200.0), np.arange(0, 3000, 200.0)), np.full((15, 20), 300.0)], -1
    )
    assert grey.sunlight(points).mean() < 0.2
    under = grey.overhead(sun, blue)
    assert under.cover > 0.75
    assert np.ptp(under.light) < 0.3 * under.light.mean() < np.ptp(blue), "blue has gone"
    veil = sky(cover=0.0, veil=1.0)
    assert 0.05 < veil.overhead(sun, blue).cover < 0.5
    assert np.all(veil.sunlight(points) == 1.0), "ice clouds throw no shadows here"


def test_clouds_belong_to_the_seed_and_the_map_not_to_the_eye() -> None:
    rays = Pose.from_angles((0.0, 0.0, 0.0), 40.0, 30.0)
    camera = CONFIG.camera_model(50.0)
    one, again, other = (sky(seed=seed).seen(camera, rays) for seed in (4, 4, 5))
    assert np.array_equal(one.opacity, again.opacity)
    assert np.array_equal(one.sun, again.sun)
    assert not np.array_equal(one.opacity, other.opacity)
    points = np.stack([*np.meshgrid(np.arange(0, 4000, 70.0), np.arange(0, 3000, 70.0)), np.full((43, 58), 300.0)], -1)
    near, far = sky().sunlight(points), sky(eye=(9000.0, -7000.0, 500.0)).sunlight(points)
    np.testing.assert_allclose(near, far, atol=1e-4)


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
