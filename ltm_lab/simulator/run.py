"""Renders a scenario frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ltm_core.base.errors import ConfigError, RasterError
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_lab.simulator.appearance import palette
from ltm_lab.simulator.clouds import Clouds
from ltm_lab.simulator.ground_io import read_codes, read_elevation
from ltm_lab.simulator.imaging import add_haze, develop, lit
from ltm_lab.simulator.landcover import UNLABELLED, WATER, LandCover, cover_geometry, make_landcover
from ltm_lab.simulator.lens import lookup, pinhole_for, through
from ltm_lab.simulator.mitsuba_scene import EyePointScenes, SceneBuilder
from ltm_lab.simulator.rasters import SiteRasters, site_rasters
from ltm_lab.simulator.render import air_length, airlight, render_radiance, render_range, white_cards
from ltm_lab.simulator.scenario import DateConfig, Scenario
from ltm_lab.simulator.sensors import Report, SensorModel
from ltm_lab.simulator.stand import changed_terrain, stand_at
from ltm_lab.simulator.terrain_synthesis import SyntheticTerrain, make_terrain, surroundings_geometry, terrain_of
from ltm_lab.simulator.truth import FrameTruth, frame_truth
from ltm_lab.simulator.vegetation import Planting
from ltm_lab.simulator.viewpoints import draw_viewpoints
from ltm_lab.simulator.walks import walk_photos
from ltm_lab.simulator.weather import mirrored, smoke
from ltm_lab.simulator.works import with_lakes

# Where in a pixel the distances for haze are taken, besides its centre
_HAZE_SAMPLES = ((-0.25, -0.25), (0.25, 0.25))


_FINER = 3.0  # rays a pixel's width when truth is looked up through a lens
_LEAST_MAST = 0.2  # m over the ground
_WATER_SKIN = 0.4  # m about a lake's level within which a point is its surface
_OPAQUE = 0.5  # opacity of smoke above which nobody can tell what is behind it


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

    Raises ConfigError on rasters that cannot be read or do not cover it, and on lakes outside it.
    """
    config, seed = scenario.terrain, scenario.seed
    if config.dem is None:
        terrain = make_terrain(config, seed)
    else:
        wide = surroundings_geometry(config)
        in_crs = wide.translated(*scenario.origin, scenario.crs)
        try:
            elevation = read_elevation(config.dem, in_crs)
        except RasterError as error:
            raise ConfigError(f"terrain.dem: {error}") from error
        terrain = terrain_of(elevation, wide, config, seed)
    terrain, lakes = with_lakes(terrain, scenario.lakes)
    codes = None
    if scenario.vegetation.fuel is not None:
        grid = cover_geometry(terrain).translated(*scenario.origin, scenario.crs)
        try:
            codes = read_codes(scenario.vegetation.fuel, grid)
        except RasterError as error:
            raise ConfigError(f"vegetation.fuel: {error}") from error
    return SimulatedSite(terrain, make_landcover(terrain, scenario.vegetation, seed, codes, lakes))


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

    `site`: the site at the first date; masts stand on its ground, whatever happens to it later. Raises ConfigError
    for a camera under that ground.
    """
    if date is None:
        date = scenario.dates[0]
    start = scenario.start_of(date)
    shots: list[Shot] = []
    for i, setup in enumerate(scenario.cameras):
        ground = float(site.terrain.site.at(setup.x, setup.y))
        height = ground + setup.mast if setup.z is None else setup.z
        if height < ground + _LEAST_MAST:
            raise ConfigError(
                f"cameras.{i}: {setup.name} stands at {height:.2f} m, {ground - height:.2f} m under the ground of "
                f"({setup.x:g}, {setup.y:g}); give z above {ground + _LEAST_MAST:.2f} or leave it out and give mast"
            )
        eye = np.array([setup.x, setup.y, height])
        patrol = setup.patrol
        pitches = patrol.pitch_deg * len(patrol.azimuth_deg) if len(patrol.pitch_deg) == 1 else patrol.pitch_deg
        sensors = SensorModel(setup.sensors(), f"{setup.name} {date.name}", scenario.seed)
        fields = patrol.hfov_deg or [setup.hfov_deg] * len(patrol.azimuth_deg)
        stops = list(zip(patrol.azimuth_deg, pitches, fields, strict=True))
        for seconds, (azimuth, pitch, hfov) in zip(patrol.begins(), stops * patrol.rounds, strict=True):
            camera = scenario.camera_model(hfov)
            stamp = start + round(seconds * 1e9)
            pose = Pose.from_angles(eye, azimuth, pitch, patrol.roll_deg)
            report = sensors.report(pose, stamp)
            if report is not None:
                shots.append(Shot(setup.name, camera, pose, stamp, height - ground, date.name, report))
    for walk in scenario.walks:
        sensors = SensorModel(walk.sensors(), f"{walk.name} {date.name}", scenario.seed)
        for seconds, pose, portrait in walk_photos(walk, site.terrain.site, scenario.seed):
            stamp = start + round(seconds * 1e9)
            report = sensors.report(pose, stamp)
            if report is not None:
                camera = scenario.camera_model(walk.hfov_deg, portrait)
                shots.append(Shot(walk.name, camera, pose, stamp, walk.eye, date.name, report))
    if scenario.views is not None:
        for place, views in enumerate(draw_viewpoints(site.terrain.site, scenario.views, scenario.seed)):
            for v in views:
                pose = Pose.from_angles(v.eye, v.azimuth_deg, v.pitch_deg, v.roll_deg)
                mast = float(v.eye[2] - site.terrain.site.at(v.eye[0], v.eye[1]))
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
    distorted = any(shot.camera.distortion)
    camera = pinhole_for(shot.camera) if distorted else shot.camera
    light = render_radiance(view, camera, pose, scenario.imaging.samples, seed)
    ranges = [render_range(view.full, camera, pose, shift) for shift in _HAZE_SAMPLES]
    is_sky = np.isinf(ranges[0])
    rays = camera.rays() @ pose.rotation.T
    points = pose.position + rays * np.where(is_sky, 0.0, ranges[0])[..., None]
    points[..., 2] += view.bend * ((points[..., :2] - pose.position[:2]) ** 2).sum(axis=-1)  # upright again
    horizon, zenith = airlight(view, camera, pose), airlight(view, camera, pose, 60.0)
    sun, sky = light.sun, light.sky
    if scenario.clouds is not None:
        datum = float(site.terrain.site.elevation.mean())
        clouds = Clouds(scenario.clouds, datum, scenario.sun, pose.position, scenario.seed)
        cards = white_cards(view, scenario.sun.elevation_deg)
        overhead = clouds.overhead(*cards)
        layer = clouds.seen(camera, pose)
        sun = sun * np.where(is_sky, 1 - layer.opacity, clouds.sunlight(points))[..., None]
        sky = np.where(is_sky[..., None], layer.over(sky, *cards), sky * overhead.factor)
        horizon, zenith = overhead.air(horizon), overhead.air(zenith)
    radiance = lit(sun, sky, is_sky)
    water = ~is_sky & (site.cover.at(points[..., 0], points[..., 1]) == WATER)
    water &= np.abs(points[..., 2] - site.terrain.site.at(points[..., 0], points[..., 1])) < _WATER_SKIN
    radiance = mirrored(radiance, water, rays, horizon, zenith, seed)
    air = [air_length(r, camera, pose) for r in ranges]
    radiance = add_haze(radiance, air, horizon, scenario.atmosphere)
    truth = _truth(view, shot.camera.scaled(scenario.truth_step), pose, site.cover)
    if scenario.smoke:
        feet = [float(site.terrain.site.at(s.x, s.y)) for s in scenario.smoke]
        white = float(np.quantile(radiance, 0.995))
        glow, alpha = smoke(scenario.smoke, feet, camera, pose, ranges[0], white, scenario.seed)
        radiance = radiance * (1 - alpha[..., None]) + glow
        _, hidden = smoke(
            scenario.smoke,
            feet,
            replace(truth.camera, distortion=(0.0,) * 5),
            pose,
            truth.range_surface,
            white,
            scenario.seed,
        )
        truth.labels[hidden > _OPAQUE] = UNLABELLED
    radiance = radiance.astype(np.float32)
    if distorted:
        maps = lookup(shot.camera, camera)
        radiance, is_sky = through(radiance, maps, smooth=True), through(is_sky, maps, smooth=False)
    return _Light(radiance, is_sky, truth)


def _truth(view: EyePointScenes, camera: Camera, pose: Pose, cover: LandCover) -> FrameTruth:
    """The truth of `camera`'s pixels; through a distorting lens, of rays within a sixth of a pixel of them."""
    if not any(camera.distortion):
        return frame_truth(view, camera, pose, cover)
    pinhole = pinhole_for(camera, finer=_FINER)
    truth, maps = frame_truth(view, pinhole, pose, cover), lookup(camera, pinhole)
    surface, ground, labels = (
        through(a, maps, smooth=False) for a in (truth.range_surface, truth.range_ground, truth.labels)
    )
    return FrameTruth(surface, ground, labels, camera)
