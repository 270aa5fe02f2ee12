"""Rays over the edges of two real surveys: what is given up, and what is called sky, before unknown ground had bounds
and since. `pytest -s` prints the shares.
"""

from pathlib import Path

import numpy as np
import pytest

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND, PossibleGround
from ltm_lab.evaluation.terrain.canyon_io import read_canyon

FRAME = SiteFrame("EPSG:32633", 446_000.0, 7_396_000.0)
ENGABREEN = Camera(4290, 2856, 6017.0, 6017.0, 2144.5, 1427.5, (-0.1155, 0.0, 0.0, 0.0, 0.0)).scaled(8)
TOWARDS = Pose.from_angles((722.0, 671.0, 770.0), 230.77, -5.79, -0.77)
SNOTINDEN = 1594.0
"""Metres: the highest ground about the glacier."""
RIM = 1700.0
"""Metres: the canyon's rim about river mile 22."""


def test_no_rock_wall_beyond_a_survey_is_sky(shared_data: Path) -> None:
    """What is sky for a tracer without bounds is rock in both photos, but for a strip along the top of Engabreen's."""
    path = shared_data / "engabreen" / "dem_3m_f64.tif"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    canyon = read_canyon(shared_data / "grandcanyon_rm22")
    views = (
        ("Engabreen", Dem.open(path).in_frame(FRAME), ENGABREEN, TOWARDS, SNOTINDEN),
        ("canyon", canyon.surveys["121004"], canyon.resection.camera.scaled(8), canyon.resection.pose, RIM),
    )
    for name, dem, camera, pose, highest in views:
        sky = []
        for possible in (NOTHING_BEYOND, PossibleGround(), PossibleGround(highest=highest)):
            ranges = TerrainTracer(dem, possible=possible).trace(camera, pose).range
            sky.append(float(np.isposinf(ranges).mean()))
            print(f"{name}, {possible}: sky {sky[-1]:.1%}, unknown {np.isnan(ranges).mean():.1%}")
        assert sky[0] > 0.1
        assert sky[1] == sky[2] == 0.0
