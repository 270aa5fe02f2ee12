from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ltm_core.cameras.sensor_pose import (
    ENU_FROM_ENU,
    ENU_FROM_EUS,
    ENU_FROM_NWU,
    OPENGL_FROM_OPTICAL,
    optical_angles_deg,
    phone_camera,
)


def test_an_upright_phone_whose_back_looks_north() -> None:
    """Android: the screen faces south, its right is east, its top is up: a quarter about x."""
    quarter = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    np.testing.assert_allclose(optical_angles_deg(ENU_FROM_ENU @ quarter @ phone_camera()), (0, 0, 0), atol=1e-9)


def test_the_same_attitude_in_apples_world_looks_west() -> None:
    """There x lies to the north, so the same quarter turns the right of the screen to the north, and its back west."""
    quarter = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    np.testing.assert_allclose(optical_angles_deg(ENU_FROM_NWU @ quarter @ phone_camera()), (270, 0, 0), atol=1e-9)


def test_a_phone_flat_on_a_table_looks_straight_down() -> None:
    """Its top to the north, so that is where the photo's top lies."""
    azimuth, pitch, _ = optical_angles_deg(phone_camera())
    assert (azimuth, pitch) == pytest.approx((0.0, -90.0), abs=1e-6)


def test_a_phone_with_its_top_to_the_left_takes_landscapes() -> None:
    """Screen to the south, top to the west, right side up: right of the picture is east."""
    device = np.column_stack([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    np.testing.assert_allclose(optical_angles_deg(device @ phone_camera(90.0)), (0, 0, 0), atol=1e-9)
    # With the top to the right the very same photo stands on its head.
    assert abs(optical_angles_deg(device @ phone_camera(270.0))[2]) == pytest.approx(180.0)


def test_arkits_camera_looks_north_without_a_turn() -> None:
    """x east, y up, z south: the camera's z points backward."""
    np.testing.assert_allclose(optical_angles_deg(ENU_FROM_EUS @ OPENGL_FROM_OPTICAL), (0, 0, 0), atol=1e-9)
