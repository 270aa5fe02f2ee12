"""Lakes with their dams."""

from __future__ import annotations

import numpy as np
import pytest
from scenes.simulated_ground import terrain

from ltm_core.base.errors import ConfigError
from ltm_lab.simulator.scenario import LakeConfig
from ltm_lab.simulator.works import with_lakes


def test_a_reservoir_is_level_and_dammed() -> None:
    ground = terrain()
    lake = LakeConfig(x=150.0, y=150.0, depth=8.0, radius=60.0)
    filled, (water,) = with_lakes(ground, [lake])
    level = float(filled.surroundings.elevation[water].max())
    np.testing.assert_array_equal(filled.surroundings.elevation[water], np.float32(level))
    x, y = np.meshgrid(*filled.site.axes())
    reach = np.hypot(x - 150, y - 150)
    flooded = (filled.site.elevation == np.float32(level)) & (reach < 60)
    assert flooded.sum() * 4 > 2000
    dam = (reach > 60) & (reach < 68) & (x < 110)
    assert np.all(filled.site.elevation[dam] >= level)
    far = (reach > 110) & (x > 170)  # away from the dam
    np.testing.assert_array_equal(filled.site.elevation[far], ground.site.elevation[far])
    assert with_lakes(ground, [])[0] is ground
    with pytest.raises(ConfigError, match=r"lakes\.0.*outside"):
        with_lakes(ground, [LakeConfig(x=9000.0, y=0.0)])
