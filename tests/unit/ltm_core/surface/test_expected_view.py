from functools import cache

import numpy as np
import pytest
from scenes.terrain_hillside import BARE, BEGIN, HOUR, LOWERED, PLACES, RAISED, RULES, SURE, frame, surface_map

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.surface.change import ChangeKind
from ltm_core.surface.config import TerrainConfig
from ltm_core.surface.observation import DepthFrame
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.surface_map import SurfaceMap
from ltm_core.tracing import TerrainTracer


@cache
def kept() -> dict[str, np.ndarray]:
    return layers(RULES)


def layers(rules: TerrainConfig) -> dict[str, np.ndarray]:
    """After cameras took turns over a surface with a pit and a mound."""
    surface = surface_map(BARE.copy(), rules)
    for hours in (0.0, 1.5, 3.0):
        for source in PLACES:
            surface.add(frame(np.where(BARE > 450.0, RAISED, LOWERED), source, hours))
    surface.decide()
    found = surface.layers()
    return {name: getattr(found, name) for name in ("height", "sigma", "change", "frames", "since")}


def test_views_that_are_kept_and_views_that_are_not_give_the_same() -> None:
    assert RULES.views_mb > 0
    anew = layers(RULES.model_copy(update={"views_mb": 0.0}))
    assert (anew["change"] > 0).sum() > 300
    for name, values in kept().items():
        np.testing.assert_array_equal(values, anew[name], err_msg=name)


@pytest.mark.parametrize(("away", "sigma", "grown"), [(60.0, 1.0, True), (93.0, 10.0, False)], ids=["within", "rim"])
def test_what_may_stand_beyond_the_terrain_is_no_growth_on_its_rim(away: float, sigma: float, grown: bool) -> None:
    """A wall across the view of a camera over a plain that ends after 98 m: on the plain, or maybe behind it."""
    plain = Dem(np.zeros((100, 80), np.float32), GridGeometry(0.0, 100.0, 1.0, 80, 100))
    camera, pose = Camera.from_fov(160, 100, 50.0), Pose.from_angles((40.0, 2.0, 10.0), 0.0, 0.0)
    depth = np.fmin(TerrainTracer(plain).trace(camera, pose).depth(), np.float32(away))
    surface = SurfaceMap(Reference.of(plain, Dem(plain.elevation.copy(), plain.geometry)), RULES, ("only",))
    for look in range(3):
        stamp = BEGIN + 2 * look * HOUR
        sure, seen = np.full(depth.shape, sigma, np.float32), np.ones(depth.shape, bool)
        surface.add(DepthFrame(depth, sure, seen, camera, pose, stamp, "only", SURE))
    surface.decide()
    layers = surface.layers()
    assert layers.observed.sum() > 1000
    assert ((layers.change == ChangeKind.GROWN).sum() > 20) == grown
