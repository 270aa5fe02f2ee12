import numpy as np
import pytest

from ltm_core.geometry.camera import Camera

pytest.importorskip("rerun", reason="the viewer's extra is not installed")

from ltm_ros.viewer import fuel_maps as archetypes


def test_shown_pinhole_projects_to_the_middle_of_the_same_place() -> None:
    """Rerun's pixel (0, 0) is the image's corner: half a pixel from ours, before and after shrinking."""
    camera = Camera(1920, 1080, 1400.0, 1410.0, 955.0, 544.0)
    pinhole = archetypes.pinhole(camera, 100.0)
    fx, _, _, _, fy, _, cx, cy, _ = np.array(pinhole.image_from_camera.as_arrow_array().to_pylist()[0])
    u, v = camera.project(np.array([3.0, -2.0, 10.0]))
    np.testing.assert_allclose([fx * 0.3 + cx, fy * -0.2 + cy], [(u + 0.5) / 2, (v + 0.5) / 2], atol=1e-3)
