"""Rotations as matrices, quaternions and rotation vectors, by SciPy.

SciPy's are loaded by the first that turns something: with the linear algebra and the trees behind them they are 0.2 s
and 20 MB of a process, and most processes of a graph (recorder, uplink, health, the runner) read a site and turn
nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.base.types import Float64Array


def matrix_of_quaternion(quaternion: ArrayLike) -> Float64Array:
    """(3, 3) of (x, y, z, w), of any norm but 0."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(quaternion).as_matrix(), np.float64)


def quaternion_of_matrix(matrix: ArrayLike) -> Float64Array:
    """(x, y, z, w) of unit norm with w >= 0, of (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(matrix).as_quat(canonical=True), np.float64)


def matrix_of_vector(vector: ArrayLike) -> Float64Array:
    """(3, 3) of a rotation vector (3,): its axis, as long as its angle in radians."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vector).as_matrix(), np.float64)


def vector_of_matrix(matrix: ArrayLike) -> Float64Array:
    """The rotation vector (3,), radians, of (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(matrix).as_rotvec(), np.float64)


def nearest_vector(vector: Float64Array, to: Float64Array) -> Float64Array:
    """Of the rotation vectors (3,) of the same rotation as `vector`, a whole turn apart, that nearest to `to`."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return vector
    axis = vector / angle
    turns = round((float(axis @ to) - angle) / (2 * np.pi))
    return np.asarray(vector + 2 * np.pi * turns * axis, np.float64)


def matrix_of_pan_tilt(pan: float, tilt: float) -> Float64Array:
    """(3, 3) of a turn about y by `pan` after one about x by `tilt`, radians."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("YX", [pan, tilt]).as_matrix(), np.float64)
