"""The sheet of a scene whose surface was confirmed: errors of depth as given, and as traced since."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_lab.evaluation.update_trial import update_figure


def test_errors_before_and_after() -> None:
    """A camera looks down on a plain from 50 m that was said to lie 10 m lower: 20 % too far."""
    grid = GridGeometry(-200.0, 300.0, 10.0, 40, 50)
    now, given = (Dem(np.full(grid.shape, level, np.float32), grid) for level in (0.0, -10.0))
    camera, pose = Camera.from_fov(12, 8, 30.0), Pose.from_angles((0.0, 0.0, 50.0), 0.0, -89.0, 0.0)
    frame = SimpleNamespace(camera=camera, pose=pose, source="oak", stamp_ns=7)
    scene = SimpleNamespace(name="level", true_now=now, given=given)
    traced = TerrainTracer(now).trace(camera, pose).depth()
    figure = update_figure(scene, [frame], {("oak", 7): ("3", traced)})  # type: ignore[arg-type, list-item]
    _, before, after = figure.axes[:3]
    np.testing.assert_allclose(before.images[0].get_array(), 0.2, atol=0.002)
    np.testing.assert_allclose(after.images[0].get_array(), 0.0, atol=1e-4)
    assert after.get_title("left") == "error of depth traced to surface 3"
