import numpy as np
import pytest

from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.tracing.horizon_profile import WEDGES_A_FACE, extended, no_wedges
from ltm_core.tracing.possible_ground import PossibleGround
from ltm_core.tracing.raster_stages import grounds, stages

HEIGHT, WIDTH = 70, 90


@pytest.mark.parametrize("offset", [0.0, 0.25])
def test_over_a_plane_every_wedge_ends_at_its_rim(offset: float) -> None:
    """Also from a node line, from which the strip behind lies at a distance of nothing."""
    geometry = GridGeometry(0.0, float(HEIGHT), 1.0, WIDTH, HEIGHT, None)
    dem = Dem(np.full((HEIGHT, WIDTH), 100.0, np.float32), geometry)
    (ground,), _ = grounds(dem, PossibleGround())
    x, y = geometry.to_map(30 + offset, 40 + offset)
    ((_, stage),) = stages(dem, np.array([x, y, 112.0]), 0.0, 1.5, 200.0)
    wedges = extended(no_wedges(), np.arange(4 * WEDGES_A_FACE, dtype=np.int64), ground, stage)
    # A ray meets the plane as far as the rim where it falls by 12 m or more on its way there.
    furthest = np.array([WIDTH - 1 - 40, 40, HEIGHT - 1 - 30, 30]) + offset * np.array([-1, 1, -1, 1])
    straight_on = [face * WEDGES_A_FACE + WEDGES_A_FACE // 2 for face in range(4)]
    np.testing.assert_allclose(wedges.highest[straight_on], -12.0 / furthest, rtol=1e-4)
    assert np.isfinite(wedges.highest).all()
