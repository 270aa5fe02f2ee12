"""Renders a scenario frame by frame."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_lab.simulator.appearance import palette
from ltm_lab.simulator.camera_setup import sensor_config
from ltm_lab.simulator.imaging import add_haze, develop, lit, mirrored, smoke
from ltm_lab.simulator.landcover import UNLABELLED, WATER, LandCover, make_landcover
from ltm_lab.simulator.mitsuba_scene import EyePointScenes, SceneBuilder
from ltm_lab.simulator.rasters import SiteRasters, site_rasters
from ltm_lab.simulator.render import (
    FrameTruth,
    air_length,
    airlight,
    frame_truth,
    render_radiance,
    render_range,
)
from ltm_lab.simulator.scenario import DateConfig, Scenario
from ltm_lab.simulator.stand import changed_terrain, stand_at
from ltm_lab.simulator.terrain_synthesis import SyntheticTerrain, make_terrain
from ltm_lab.simulator.vegetation import Planting
from ltm_lab.simulator.viewpoints import Report, SensorModel, draw_viewpoints, walk_photos
from ltm_lab.simulator.works import with_lakes

# Where in a pixel the distances for haze are taken, besides its centre
_HAZE_SAMPLES = ((-0.25, -0.25), (0.25, 0.25))
_LEAST_MAST = 0.2  # m over the ground
_WATER_SKIN = 0.4  # m about a lake's level within which a point is its surface
_OPAQUE = 0.5  # opacity of smoke above which pixels have no class


@dataclass(frozen=True)
class Shot:
    """One frame to be rendered, and what its camera's sensors say of it."""

    camera_name: str
    camera: Camera
    pose: Pose
    stamp_ns: int
    mast: float
    date: str
    report: Report


@dataclass(frozen=True)
class SimulatedFrame:
    """One rendered frame: `image` (H, W, 3) uint8 sRGB and what is true of it."""

    shot: Shot
    image: UInt8Array
    truth: FrameTruth


@dataclass(frozen=True)
class SimulatedSite:
    """The ground and what grows on it."""

    terrain: SyntheticTerrain
    cover: LandCover


def make_site(scenario: Scenario) -> SimulatedSite:
    """The site as it was before the scenario's first date: a function of its seed, terrain and vegetation alone.

    Raises ConfigError on lakes outside it.
    """
    seed = scenario.seed
    terrain, lakes = with_lakes(make_terrain(scenario.terrain, seed), scenario.lakes)
    return SimulatedSite(terrain, make_landcover(terrain, scenario.vegetation, seed, lakes))


def site_at(scenario: Scenario, site: SimulatedSite, date: DateConfig) -> SimulatedSite:
    """The site at one of the scenario's dates: its years and changes applied; what they do not touch stays the same."""
    v = scenario.vegetation
    terrain = changed_terrain(site.terrain, scenario.changes, date.years, scenario.seed)
    cover = stand_at(site.cover, scenario.changes, date.years, v.age, v.growing, scenario.seed)
    return SimulatedSite(terrain, cover)


def rasters_at(scenario: Scenario, site: SimulatedSite) -> SiteRasters:
    """The true rasters of a dated site."""
    v = scenario.vegetation
    planting = Planting(site.terrain, site.cover, v, palette(v.green, scenario.seed), scenario.seed)
    return site_rasters(site.terrain.site, site.cover, planting, scenario.origin, scenario.crs)


def plan_shots(scenario: Scenario, site: SimulatedSite, date: DateConfig | None = None) -> list[Shot]:
    """All frames of a date (the first unless given), one eye point after another, each eye's in time order.

    `site`: the site at the first date; masts stand on its ground, whatever happens to it later.
    """
    if date is None:
        date = scenario.dates[0]
    start, ground = scenario.start_of(date), site.terrain.site
    shots: list[Shot] = []
    for setup in scenario.cameras:
        over = float(ground.at(setup.x, setup.y))
        eye = np.array([setup.x, setup.y, over + setup.mast])
        patrol, camera = setup.patrol, scenario.camera_model(setup.hfov_deg)
        pitches = patrol.pitch_deg * len(patrol.azimuth_deg) if len(patrol.pitch_deg) == 1 else patrol.pitch_deg
        sensors = SensorModel(sensor_config(setup.sensor), f"{setup.name} {date.name}", scenario.seed)
        stops = list(zip(patrol.azimuth_deg, pitches, strict=True))
        for seconds, (azimuth, pitch) in zip(patrol.begins(), stops * patrol.rounds, strict=True):
            stamp, pose = start + round(seconds * 1e9), Pose.from_angles(eye, azimuth, pitch)
            report = sensors.report(pose, stamp)
            shots.append(Shot(setup.name, camera, pose, stamp, float(eye[2]) - over, date.name, report))
    for walk in scenario.walks:
        sensors = SensorModel(sensor_config(walk.sensor), f"{walk.name} {date.name}", scenario.seed)
        for seconds, pose, portrait in walk_photos(walk, ground, scenario.seed):
            stamp, camera = start + round(seconds * 1e9), scenario.camera_model(walk.hfov_deg, portrait)
            shots.append(Shot(walk.name, camera, pose, stamp, walk.eye, date.name, sensors.report(pose, stamp)))
    if scenario.views is not None:
        for place, views in enumerate(draw_viewpoints(ground, scenario.views, scenario.seed)):
            for v in views:
                pose = Pose.from_angles(v.eye, v.azimuth_deg, v.pitch_deg, v.roll_deg)
                mast = float(v.eye[2] - ground.at(v.eye[0], v.eye[1]))
                stamp = start + len(shots) * 2_000_000_000
                camera, exact = scenario.camera_model(v.hfov_deg), Report.exact(pose, stamp)
                shots.append(Shot(f"view{place:02d}", camera, pose, stamp, mast, date.name, exact))
    return shots


def render_shots(
    scenario: Scenario, site: SimulatedSite, shots: list[Shot], view: EyePointScenes | None = None
) -> Iterator[SimulatedFrame]:
    """Render `shots` of one dated site one after another; the scene is rebuilt only where the eye moves. `view`: the
    first eye's, if it is there already.

    Nothing in the scene moves, so a pose that comes again shares its light and its truth with the first time; the
    sensor's noise is its own.
    """
    builder: SceneBuilder | None = None
    eye: Float64Array | None = shots[0].pose.position if shots and view is not None else None
    seen: dict[tuple[Camera, Pose], _Light] = {}
    for k, shot in enumerate(shots):
        over = float(shot.pose.position[2] - site.terrain.site.at(*shot.pose.position[:2]))
        if over < _LEAST_MAST:
            names = [c.name for c in scenario.cameras]
            place = f"cameras.{names.index(shot.camera_name)}: " if shot.camera_name in names else ""
            raise ConfigError(
                f"{place}camera {shot.camera_name} is {-over:.2f} m under the ground that changes up to {shot.date} "
                "leave; raise its mast or keep the change away from it"
            )
        if view is None or eye is None or not np.array_equal(eye, shot.pose.position):
            view, eye = None, shot.pose.position  # the old scene goes before the new one comes
            seen.clear()
            builder = builder or SceneBuilder(scenario, site.terrain, site.cover)
            view = builder.view(eye)
        seed = scenario.seed * 10_007 + k
        key = (shot.camera, shot.pose)
        if key not in seen:
            seen[key] = _light(scenario, site, view, shot, seed)
        light = seen[key]
        image = develop(light.radiance, shot.camera, scenario.imaging, seed, light.is_sky)
        yield SimulatedFrame(shot, image, light.truth)


@dataclass(frozen=True)
class _Light:
    radiance: Float32Array
    is_sky: BoolArray
    truth: FrameTruth


def _light(scenario: Scenario, site: SimulatedSite, view: EyePointScenes, shot: Shot, seed: int) -> _Light:
    """What reaches the lens, and what is true of it."""
    pose = shot.pose
    camera = shot.camera
    light = render_radiance(view, camera, pose, scenario.imaging.samples, seed)
    ranges = [render_range(view.full, camera, pose, shift) for shift in _HAZE_SAMPLES]
    is_sky = np.isinf(ranges[0])
    rays = camera.rays() @ pose.rotation.T
    points = pose.position + rays * np.where(is_sky, 0.0, ranges[0])[..., None]
    points[..., 2] += view.bend * ((points[..., :2] - pose.position[:2]) ** 2).sum(axis=-1)  # upright again
    horizon, zenith = airlight(view, camera, pose), airlight(view, camera, pose, 60.0)
    radiance = lit(light.sun, light.sky, is_sky)
    water = ~is_sky & (site.cover.at(points[..., 0], points[..., 1]) == WATER)
    water &= np.abs(points[..., 2] - site.terrain.site.at(points[..., 0], points[..., 1])) < _WATER_SKIN
    radiance = mirrored(radiance, water, rays, horizon, zenith, seed)
    air = [air_length(r, camera, pose) for r in ranges]
    radiance = add_haze(radiance, air, horizon, scenario.atmosphere)
    truth = frame_truth(view, camera.scaled(scenario.truth_step), pose, site.cover)
    if scenario.smoke:
        feet = [float(site.terrain.site.at(s.x, s.y)) for s in scenario.smoke]
        white = float(np.quantile(radiance, 0.995))
        glow, alpha = smoke(scenario.smoke, feet, camera, pose, ranges[0], white, scenario.seed)
        radiance = radiance * (1 - alpha[..., None]) + glow
        _, hidden = smoke(scenario.smoke, feet, truth.camera, pose, truth.range_surface, white, scenario.seed)
        truth.labels[hidden > _OPAQUE] = UNLABELLED
    return _Light(radiance.astype(np.float32), is_sky, truth)
