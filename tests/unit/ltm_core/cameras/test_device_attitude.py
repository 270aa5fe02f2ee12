import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ltm_core.cameras.sensor_pose import ENU_FROM_ENU, ENU_FROM_NWU, optical_angles_deg, phone_camera


@pytest.mark.parametrize(("world", "azimuth"), [(ENU_FROM_ENU, 0), (ENU_FROM_NWU, 270)])
def test_an_upright_phone_whose_back_looks_north_or_in_apples_world_west(world: np.ndarray, azimuth: float) -> None:
    """Android: the screen faces south, its right is east, its top is up: a quarter about x."""
    quarter = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    np.testing.assert_allclose(optical_angles_deg(world @ quarter @ phone_camera()), (azimuth, 0, 0), atol=1e-9)


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
