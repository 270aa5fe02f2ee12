from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scenes.small_scenario import small_scenario

from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.monocular import DepthNetwork
from ltm_core.depth.topodepth import fuse
from ltm_core.fuel.label_errors import known_errors
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.surface.config import TerrainConfig
from ltm_core.surface.observation import DepthFrame
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.surface_map import SurfaceMap
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.manifest import DEFAULT_MODEL
from ltm_core.vision.segmenter import Segmenter

pytest.importorskip("mitsuba", reason="the simulator's extra is not installed")

from ltm_core.base.types import Float32Array, Float64Array, UInt8Array
from ltm_lab.simulator import noise_fields
from ltm_lab.simulator.imaging import smoke
from ltm_lab.simulator.run import make_site, plan_shots, rasters_at, render_shots
from ltm_lab.simulator.scenario import SmokeConfig

pytestmark = pytest.mark.slow

HOUR = 3_600_000_000_000
BEGIN = 1_700_000_000_000_000_000
LOOKS = 4
SURE = np.diag([1e-6] * 3 + [1e-12] * 3)
FIRES = {
    "west": [(120, 122), (140, 140), (150, 120), (130, 150)],
    "east": [(240, 125), (225, 140), (250, 150), (232, 115)],
}
"""Map x, y of the smoke's foot, look by look, in view of each camera."""


@dataclass(frozen=True, eq=False)
class Look:
    """A camera's clear photo, linear (H, W, 3), and slant range (H, W) to what it shows, +inf sky."""

    name: str
    camera: Camera
    pose: Pose
    radiance: Float64Array
    range: Float32Array


@dataclass(frozen=True, eq=False)
class Slope:
    """A hillside with shrubs and trees whose surface is known, and two cameras that look at it."""

    bare: Dem
    surface: Dem
    looks: list[Look]


@pytest.fixture(scope="module")
def slope() -> Slope:
    rounds = {"azimuth_deg": [20.0], "pitch_deg": [-8.0]}
    config = small_scenario(
        image={"width": 384, "height": 216},
        imaging={"samples": 4},
        lakes=[],
        changes=[],
        dates=[{"name": "now"}],
        vegetation={"detail_radius": 300.0, "grass_radius": 20.0, "tree": 0.15, "grass": 0.4},
        cameras=[
            {"name": "west", "x": 110.0, "y": 70.0, "mast": 25.0, "patrol": rounds},
            {"name": "east", "x": 250.0, "y": 70.0, "mast": 25.0, "patrol": rounds | {"azimuth_deg": [345.0]}},
        ],
    )
    site = make_site(config)
    rasters = rasters_at(config, site)
    x, y = config.origin
    frame = rasters.fine.translated(-x, -y)
    looks = [
        Look(f.shot.camera_name, f.shot.camera, f.shot.pose, (f.image / 255.0) ** 2.2, f.truth.range_surface)
        for f in render_shots(config, site, plan_shots(config, site))
    ]
    return Slope(Dem(rasters.bare_earth, frame), Dem(rasters.surface, frame), looks)


def photo(radiance: NDArray[np.floating]) -> UInt8Array:
    return (np.clip(radiance, 0, 1) ** (1 / 2.2) * 255).round().astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Veil:
    """Smoke before a look: its light (H, W, 3), how much of each pixel it hides (H, W), and its distance in metres."""

    light: NDArray[np.floating]
    hidden: NDArray[np.floating]
    away: float


def veil(slope: Slope, look: Look, number: int) -> Veil:
    """Smoke that rises before the slope, elsewhere for each number."""
    x, y = FIRES[look.name][number]
    column = SmokeConfig(x=x, y=y, height=70.0, drift=60.0, wind_deg=90.0 * number)
    far = np.where(np.isfinite(look.range), look.range, np.float32(1e5))
    light, hidden = smoke([column], [float(slope.bare.elevation_at(x, y))], look.camera, look.pose, far, 0.75, number)
    return Veil(light, hidden, float(np.hypot(x - look.pose.position[0], y - look.pose.position[1])))


def smoky(slope: Slope, look: Look, number: int) -> tuple[UInt8Array, float]:
    """Its photo with smoke before it, and the share of the land which that hides."""
    before = veil(slope, look, number)
    land = np.isfinite(look.range)
    return photo(look.radiance * (1 - before.hidden[..., None]) + before.light), float(
        ((before.hidden > 0.3) & land).mean()
    )


def shaded(slope: Slope, look: Look, number: int) -> tuple[UInt8Array, float]:
    """Its photo under clouds elsewhere at each look, and the share of the land in their shade."""
    land = np.isfinite(look.range)
    rays = look.camera.rays() @ look.pose.rotation.T
    points = look.pose.position + rays * np.where(land, look.range, 0)[..., None]
    # Shadows of clouds of 150 m and less over half of the ground, their edges a few metres wide
    thin = noise_fields.at_points(points[..., 0].ravel(), points[..., 1].ravel(), 300.0, 40 + number, octaves=4)
    lit = np.clip(0.5 + 20 * thin.reshape(land.shape), 0.03, 1.0)
    lit = np.where(land, cv2.GaussianBlur(lit, (0, 0), 1.0), 1.0)
    return photo(look.radiance * (0.3 + 0.7 * lit[..., None])), float((lit[land] < 0.5).mean())


Weather = Callable[[Slope, Look, int], tuple[UInt8Array, float]]


@dataclass(frozen=True, eq=False)
class Watch:
    """A map of a slope as it is given, bare and with what grows there, to which photos come by way of fusion, as in the
    graph, with their labels, under the rules of a site."""

    given: tuple[Dem, Dem]
    segmenter: Segmenter
    classes: ClassPriors

    def changed(
        self, photos: Iterable[tuple[Look, UInt8Array]], network: DepthNetwork
    ) -> tuple[set[tuple[int, int]], int]:
        """Cells that the map takes for changed after photos two hours apart, and how many it has looked at."""
        bare, surface = (TerrainTracer(dem) for dem in self.given)
        rules = TerrainConfig()
        gone = known_errors(DEFAULT_MODEL).open_odds()
        living = SurfaceMap(Reference.of(*self.given, rules.resolution), rules, sorted(FIRES), gone=gone)
        for number, (look, rgb) in enumerate(photos):
            ground, canopy = (tracer.trace(look.camera, look.pose) for tracer in (bare, surface))
            seen, labels = network.predict(rgb, look.camera), self.segmenter.segment(rgb).labels
            own = fuse(ground, seen, rgb, labels, self.classes, surface=canopy).measured()
            stamp = BEGIN + number // 2 * 2 * HOUR + number
            of = look.camera, look.pose, stamp, look.name, SURE
            living.add(DepthFrame.of_photo(own.depth, own.sigma, *of, labels))
        changed = living.decide()
        looked = int(living.layers().observed.sum())
        return {(int(r), int(c)) for r, c in zip(changed.rows, changed.cols, strict=True)}, looked


@pytest.fixture(scope="module")
def watch(slope: Slope) -> Watch:
    return Watch((slope.bare, slope.surface), Segmenter.open(DEFAULT_MODEL), ClassPriors.of(LabelSet.load()))


@pytest.fixture(scope="module")
def shipped() -> DepthNetwork:
    return DepthNetwork.open("landscape_lite0_depth")


@pytest.mark.parametrize("weather", [smoky, shaded], ids=["smoke", "shade"])
def test_weather_before_the_shipped_network_changes_nothing(
    slope: Slope, watch: Watch, shipped: DepthNetwork, weather: Weather
) -> None:
    shares: list[float] = []

    def photos() -> Iterator[tuple[Look, UInt8Array]]:
        for number in range(LOOKS):
            for look in slope.looks:
                rgb, share = weather(slope, look, number)
                shares.append(share)
                yield look, rgb

    changed, looked = watch.changed(photos(), shipped)
    assert np.mean(np.array(shares) > 0.02) >= 0.5, "the weather is seen"
    assert looked > 3000  # in smoke the shipped network fits the terrain in half as many looks as in clear weather
    assert not changed
