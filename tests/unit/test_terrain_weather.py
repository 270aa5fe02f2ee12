"""Smoke and shadows of clouds before a camera, from photo to surface map: nothing that they hide or darken changes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from small_scenario import small_scenario

from ltm_core.camera import Camera
from ltm_core.dem import Dem
from ltm_core.depth.classes import DepthClasses
from ltm_core.depth.fusion import Source, fuse
from ltm_core.depth.monocular import DepthNetwork
from ltm_core.pose import Pose
from ltm_core.site import TerrainConfig
from ltm_core.terrain import DepthFrame, Reference, SurfaceMap
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.segmenter import DEFAULT_MODEL, Segmenter

pytest.importorskip("mitsuba", reason="the simulator's extra is not installed")

from ltm_core.simulator.clouds import Clouds
from ltm_core.simulator.run import make_site, plan_shots, rasters_at, render_shots
from ltm_core.simulator.scenario import CloudConfig, SmokeConfig, SunConfig
from ltm_core.simulator.weather import smoke

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
SUN = SunConfig()


@dataclass(frozen=True, eq=False)
class Look:
    """A camera's clear photo, linear (H, W, 3), and slant range (H, W) to what it shows, +inf sky."""

    name: str
    camera: Camera
    pose: Pose
    radiance: NDArray[np.float64]
    range: NDArray[np.float32]


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


def photo(radiance: NDArray[np.floating]) -> NDArray[np.uint8]:
    return (np.clip(radiance, 0, 1) ** (1 / 2.2) * 255).round().astype(np.uint8)


def smoky(slope: Slope, look: Look, number: int) -> tuple[NDArray[np.uint8], float]:
    """Its photo with smoke that rises before the slope, and the share of the land which that hides."""
    x, y = FIRES[look.name][number]
    column = SmokeConfig(x=x, y=y, height=70.0, drift=60.0, wind_deg=90.0 * number)
    far = np.where(np.isfinite(look.range), look.range, np.float32(1e5))
    light, hidden = smoke([column], [float(slope.bare.elevation_at(x, y))], look.camera, look.pose, far, 0.75, number)
    return photo(look.radiance * (1 - hidden[..., None]) + light), float(((hidden > 0.3) & (far < 1e5)).mean())


def shaded(slope: Slope, look: Look, number: int) -> tuple[NDArray[np.uint8], float]:
    """Its photo under clouds elsewhere at each look, and the share of the land in their shade."""
    land = np.isfinite(look.range)
    rays = look.camera.rays() @ look.pose.rotation.T
    points = look.pose.position + rays * np.where(land, look.range, 0)[..., None]
    sky = CloudConfig(cover=0.6, base=400.0, size=300.0, depth=300.0)
    lit = Clouds(sky, float(np.mean(slope.bare.elevation)), SUN, look.pose.position, number).sunlight(points)
    lit = np.where(land, cv2.GaussianBlur(lit, (0, 0), 1.0), 1.0)
    return photo(look.radiance * (0.3 + 0.7 * lit[..., None])), float((lit[land] < 0.5).mean())


@dataclass(frozen=True, eq=False)
class Eyes:
    """The shipped networks, fusion and tracer over one slope."""

    slope: Slope
    tracer: TerrainTracer
    segmenter: Segmenter
    network: DepthNetwork
    classes: DepthClasses

    def changed(
        self, photos: Iterator[tuple[Look, NDArray[np.uint8]]], rules: TerrainConfig | None = None
    ) -> tuple[set[tuple[int, int]], int]:
        """Cells that the map takes for changed after photos two hours apart, and how many it has looked at. `rules`:
        by default of a map that takes each look's errors for new ones and one camera's word for as good as two's: the
        network is not sure enough of anything here to move the map otherwise, whatever the weather."""
        rules = rules or TerrainConfig(pixel_step=1, repeats=0.0, alone=3.0)
        names = sorted(look.name for look in self.slope.looks)
        surface = SurfaceMap(Reference.of(self.slope.bare, self.slope.surface, rules.resolution), rules, names)
        for number, (look, rgb) in enumerate(photos):
            traced = self.tracer.trace(look.camera, look.pose)
            seen = self.network.predict(rgb, look.camera)
            fused = fuse(traced, seen, rgb, self.segmenter.segment(rgb).labels, self.classes)
            measured = (fused.source == Source.NETWORK) | (fused.source == Source.BOTH)
            stamp = BEGIN + number // 2 * 2 * HOUR + number
            surface.add(DepthFrame(fused.depth, fused.sigma, measured, look.camera, look.pose, stamp, look.name, SURE))
        changed = surface.decide()
        looked = int(surface.layers().observed.sum())
        return {(int(r), int(c)) for r, c in zip(changed.rows, changed.cols, strict=True)}, looked


@pytest.fixture(scope="module")
def eyes(slope: Slope) -> Eyes:
    classes = DepthClasses.of(LabelSet.load())
    network = DepthNetwork.open("landscape_lite0_depth")
    return Eyes(slope, TerrainTracer(slope.surface), Segmenter.open(DEFAULT_MODEL), network, classes)


@pytest.mark.parametrize("weather", [smoky, shaded], ids=["smoke", "shade"])
def test_weather_changes_no_more_than_a_clear_sky(eyes: Eyes, weather: object) -> None:
    """Photos in which the weather is elsewhere each time, beside as many clear ones of the same views: whatever the
    networks get wrong of this slope, they get wrong without weather."""
    shares: list[float] = []

    def photos() -> Iterator[tuple[Look, NDArray[np.uint8]]]:
        for number in range(LOOKS):
            for look in eyes.slope.looks:
                rgb, share = weather(eyes.slope, look, number)  # type: ignore[operator]
                shares.append(share)
                yield look, rgb

    clear, looked = eyes.changed((look, photo(look.radiance)) for _ in range(LOOKS) for look in eyes.slope.looks)
    under, _ = eyes.changed(photos())
    assert np.mean(np.array(shares) > 0.02) >= 0.5, "the weather is seen"
    assert looked > 1000
    assert len(under - clear) < 0.005 * looked


def test_a_network_that_errs_alike_in_each_look_changes_nothing(eyes: Eyes) -> None:
    """The same photos twelve times over, under the rules of a site: errors that repeat are no evidence."""
    rules = TerrainConfig(pixel_step=1)
    changed, looked = eyes.changed(
        ((look, photo(look.radiance)) for _ in range(12) for look in eyes.slope.looks), rules
    )
    assert looked > 1000
    assert not changed


@pytest.mark.xfail(
    strict=True,
    reason="fusion believes a network less against a label than when this was written, and its sigma has become too "
    "small for a map that takes each look's errors for new: as many cells change elsewhere as in the place",
)
def test_what_stands_there_since_is_found_on_the_same_slope(slope: Slope, eyes: Eyes) -> None:
    """So that no change above is no blindness: the map is told of a slope that is 6 m lower in one place."""
    geometry = slope.surface.geometry
    x, y = geometry.to_map(*np.mgrid[: geometry.height, : geometry.width])
    place = np.hypot(x - 200.0, y - 140.0) < 20.0
    told = [Dem((dem.elevation - 6.0 * place).astype(np.float32), geometry) for dem in (slope.bare, slope.surface)]
    lower = replace(eyes, slope=Slope(*told, slope.looks), tracer=TerrainTracer(told[1]))
    changed, _ = lower.changed((look, photo(look.radiance)) for _ in range(LOOKS) for look in slope.looks)
    inside = [place[cell] for cell in changed]
    assert sum(inside) > 40
    assert np.mean(inside) > 0.6
