"""A real photo with surveyed control points: each located with the pose that the others give."""

from pathlib import Path

import numpy as np
import pytest

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame, ray_bend
from ltm_core.locating.settings import LocatingConfig
from ltm_core.pose_estimation.points.resection_io import read_control_points
from ltm_core.raster.dem import Dem
from ltm_lab.evaluation.locating.control_points import located_points

pytestmark = pytest.mark.slow


def test_surveyed_points_lie_in_their_ellipses(shared_data: Path) -> None:
    folder = shared_data / "engabreen"
    frame = SiteFrame("EPSG:32633", 446_000.0, 7_396_000.0)
    dem = Dem.open(folder / "dem_3m_f64.tif").in_frame(frame)
    points = read_control_points(folder / "gcp8902.csv", frame, first_pixel=1.0)
    camera = Camera(4290, 2856, 5850.0, 5850.0, 2144.5, 1427.5)
    position = np.array([722.0, 671.0, 770.0])
    config = LocatingConfig(dem_sigma=1.5)
    found = [p.place for p in located_points(points, camera, position, dem, ray_bend(True, 0.13), config)]
    assert len(found) == 14
    assert sum(point.in_95 for point in found) >= 13
    assert np.median([point.likeliest_error for point in found]) < 5.0
    # Where the raster hides a point its region is long, and where it does not it is small.
    assert sum(point.major < 15 for point in found) >= 6
    assert max(point.major for point in found) > 100
