"""`ltm-lab bench render`: processor time, wall time and memory of one rendered frame and of setting up its scene."""

from __future__ import annotations

from dataclasses import dataclass

from ltm_core.base.errors import ConfigError
from ltm_lab.bench.measure import Cost, cost_of, peak_mb
from ltm_lab.simulator.mitsuba_scene import EyePointScenes, SceneBuilder
from ltm_lab.simulator.run import SimulatedFrame, SimulatedSite, make_site, plan_shots, render_shots, site_at
from ltm_lab.simulator.scenario import Scenario

_MORE = 1.05  # by which the detail radius aims beyond what is asked for
_TRIES = 5


@dataclass(frozen=True)
class RenderCost:
    """`site`: ground and what grows there. `scene`: textures, plants and the scene of one eye point. `frame`: one
    frame with its truth. `instances`: of the scene, `near` of them in full detail."""

    width: int
    height: int
    samples: int
    detail_radius: float
    instances: int
    near: int
    site: Cost
    scene: Cost
    frame: Cost
    peak_mb: float


def run_rendering(scenario: Scenario, least_near: int) -> RenderCost:
    """Render the first frame of the scenario's last date, the radius of detail widened until `least_near` near
    instances stand in its scene. Raises ConfigError where so many are not in sight."""
    date = scenario.dates[-1]
    here = scenario.at(date)
    sites: list[SimulatedSite] = []
    site_cost = cost_of(lambda: sites.append(site_at(here, make_site(here), date)))
    shot = plan_shots(here, sites[0], date)[0]
    for _ in range(_TRIES):
        views: list[EyePointScenes] = []
        scene_cost = cost_of(
            lambda: views.append(SceneBuilder(here, sites[0].terrain, sites[0].cover).view(shot.pose.position))  # noqa: B023
        )
        if views[0].near >= least_near:
            break
        here = _wider(here, least_near / max(views[0].near, 1))
    else:
        raise ConfigError(f"{here.name}: no {least_near} near instances in sight of {shot.camera_name}; ask for fewer")
    frames: list[SimulatedFrame] = []
    frame_cost = cost_of(lambda: frames.extend(render_shots(here, sites[0], [shot], views[0])))
    return RenderCost(
        shot.camera.width,
        shot.camera.height,
        here.imaging.samples,
        here.vegetation.detail_radius,
        views[0].instances,
        views[0].near,
        site_cost,
        scene_cost,
        frame_cost,
        peak_mb(),
    )


def _wider(scenario: Scenario, more: float) -> Scenario:
    vegetation = scenario.vegetation
    radius = vegetation.detail_radius * _MORE * more**0.5
    return scenario.model_copy(update={"vegetation": vegetation.model_copy(update={"detail_radius": radius})})
