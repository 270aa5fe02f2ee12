import math

import pytest

from ltm_core.cameras.plausibility import doubt_of_height, doubt_of_radians


@pytest.mark.parametrize(
    ("azimuths", "part"),
    [
        ([3.7], "azimuths from 3.7 to 3.7 lie within 2 pi"),
        ([3.7, 3.7], "(3.7 rad is 212.0 deg)"),
        ([0.31, 6.1, 2.0], "azimuths from 0.31 to 6.1 lie"),
        ([1.5, 3], "(1.5 rad is 85.9 deg)"),
        ([-2.5, 1], "(-2.5 rad is 216.8 deg)"),
    ],
)
def test_radians_are_doubted(azimuths: list[float], part: str) -> None:
    assert part in (doubt_of_radians(azimuths) or "")


@pytest.mark.parametrize("azimuths", [[], [0.0], [3], [0, 3, 5], [3.7, 6.4], [212.0], [-7.5, 1.5]])
def test_what_degrees_look_like(azimuths: list[float]) -> None:
    assert doubt_of_radians(azimuths) is None


@pytest.mark.parametrize(
    ("z", "ground", "part"),
    [
        (2988.8, 900.0, "as feet it would be 911 m"),
        (1300.0, 900.0, "higher than masts"),
        (911.0, 2953.0, "if the DEM's heights are feet, the ground is at 900 m"),
        (90.0, 100.0, "10.00 m under the ground, which is at 100.00 m"),
        (880.0, 900.0, "20.00 m under the ground, which is at 900.00 m"),
        (900.0, 900.0, "0.00 m under the ground"),
    ],
)
def test_heights_are_doubted(z: float, ground: float, part: str) -> None:
    assert part in (doubt_of_height(z, ground) or "")


@pytest.mark.parametrize(("z", "ground"), [(902.0, 900.0), (1049.0, 900.0), (-3.0, -5.0), (1300.0, math.nan)])
def test_heights_that_may_be(z: float, ground: float) -> None:
    assert doubt_of_height(z, ground) is None
