"""Attitude of devices that carry a camera: from their own axes and worlds to the angles of a pose.

A device tells how its axes lie in a world of its own. `ENU_FROM_*` take each of these worlds to east, north, up of the
device's own north (true or magnetic); `phone_camera` says how a phone's back camera is mounted. Sources: Android's
SensorManager (x east, y north, z up), Apple's CMAttitudeReferenceFrame (x north, z up), ARKit's `gravityAndHeading`
(x east, y up, z south), and the axes of a phone that all three share: x to the right of the screen, y to its top, z out
of it towards the person.
"""

from __future__ import annotations

import math

import numpy as np

from ltm_core.pose import Pose
from ltm_core.types import Float64Array

ENU_FROM_ENU = np.eye(3)
ENU_FROM_NWU = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Apple's CoreMotion with x to the north and z up."""
ENU_FROM_EUS = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""ARKit with `gravityAndHeading`: x east, y up, z south."""
OPENGL_FROM_OPTICAL = np.diag([1.0, -1.0, -1.0])
"""Camera axes x right, y up, z backward (ARKit, OpenGL) from the optical frame's x right, y down, z forward."""


def phone_camera(turned_deg: float = 0.0) -> Float64Array:
    """(3, 3): the optical frame of an upright photo of the back camera to the phone's axes.

    `turned_deg`: by how much the phone was turned counter-clockwise, as the one who holds it sees it, from portrait: 90
    for landscape with the top to the left.
    """
    t = math.radians(turned_deg)
    cosine, sine = (round(v, 12) if turned_deg % 90 == 0 else v for v in (math.cos(t), math.sin(t)))
    right, down = np.array([cosine, -sine, 0.0]), np.array([-sine, -cosine, 0.0])
    return np.column_stack([right, down, [0.0, 0.0, -1.0]])


def held_phone(enu_from_phone: Float64Array | None, portrait: bool, turned_deg: tuple[float, ...] = ()) -> Float64Array:
    """`phone_camera` of a photo, by how the phone was held: of `turned_deg`, or else of what its image's shape allows,
    as the picture stands most upright. Without an attitude (None) the first of them.
    """
    allowed = turned_deg or ((0.0,) if portrait else (90.0, 270.0))
    mounts = [phone_camera(angle) for angle in allowed]
    if enu_from_phone is None or len(mounts) == 1:
        return mounts[0]
    return min(mounts, key=lambda mount: abs(optical_angles_deg(enu_from_phone @ mount)[2]))


def optical_angles_deg(enu_from_optical: Float64Array) -> tuple[float, float, float]:
    """Azimuth from the world's north, pitch and roll of a camera, as `Pose.from_angles` takes them.

    Raises PoseError on a matrix that is no rotation.
    """
    return Pose(np.zeros(3), enu_from_optical).angles_deg
