from __future__ import annotations

import numpy as np
import pytest

from ltm_core.fuel.stand_allometry import ForestType, crown_fuel


def test_a_stand_by_hand() -> None:
    """55 % and 14 m: crowns of 2.1 m, 0.7985 / 13.854 m2 = 576.4 stems/ha of 20 cm, 18.107 m2/ha."""
    found = crown_fuel(np.array([55.0]), np.array([14.0]), ForestType.MIXED_CONIFER)
    assert found.base[0] == pytest.approx(-1.463 + 0.578 * 14 + 0.026 * 18.107, abs=1e-3)
    assert found.density[0] == pytest.approx(np.exp(-8.445) * 18.107**0.319 * 576.4**0.859, rel=1e-3)


@pytest.mark.parametrize("forest", ForestType)
def test_closer_stands_are_denser_and_taller_ones_have_higher_crowns(forest: ForestType) -> None:
    cover, height = np.meshgrid([5.0, 30.0, 70.0, 100.0], [1.0, 2.0, 8.0, 20.0, 60.0])
    found = crown_fuel(cover, height, forest)
    assert (np.diff(found.density[:, :3], axis=1) > 0).all()
    assert (np.diff(found.base, axis=0) > 0).all()
    assert (found.base <= height).all()
    assert (found.base > 0).all()
    assert np.isfinite(found.density).all()
