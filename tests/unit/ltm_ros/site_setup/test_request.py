import math

import pytest

from ltm_core.base.errors import ConfigError
from ltm_ros.site_setup.request import Area


@pytest.mark.parametrize(
    "bounds", [(179.9, 52.0, 180.1, 52.1), (9.0, 89.9, 10.0, 90.1), (1.0, 2.0, 1.0, 3.0), (0.0, 0.0, math.nan, 1.0)]
)
def test_areas_that_cannot_be_are_errors(bounds: tuple[float, float, float, float]) -> None:
    with pytest.raises(ConfigError):
        Area(bounds)
