"""Rotation vectors of one rotation, whole turns apart."""

from __future__ import annotations

import numpy as np
import pytest

from ltm_core.geometry.pose import matrix_of_vector, nearest_vector


@pytest.mark.parametrize(("told", "to", "expected"), [(179.0, -179.0, -181.0), (-179.0, 540.0, 541.0), (5.0, 1.0, 5.0)])
def test_the_nearest_vector_of_the_same_rotation(told: float, to: float, expected: float) -> None:
    axis = np.array([0.6, 0.0, 0.8])
    found = nearest_vector(np.radians(told) * axis, np.radians(to) * axis)
    np.testing.assert_allclose(np.degrees(found), expected * axis)
    np.testing.assert_allclose(matrix_of_vector(found), matrix_of_vector(np.radians(told) * axis), atol=1e-12)


def test_no_rotation_stays_none() -> None:
    assert nearest_vector(np.zeros(3), np.array([0.0, 0.0, 6.0])).tolist() == [0.0, 0.0, 0.0]
