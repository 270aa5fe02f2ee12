"""A real photo with surveyed control points: the traced place of each point's pixel against where it was surveyed."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer

# Angles, focal length and k1 fitted to the control points; the position is the surveyed one.
POSITION = (446_722.0, 7_396_671.0, 770.0)
CAMERA = Camera(4290, 2856, 6017.0, 6017.0, 2144.5, 1427.5, (-0.1155, 0.0, 0.0, 0.0, 0.0))
ANGLES_DEG = (230.77, -5.79, -0.77)


def test_control_points(shared_data: Path) -> None:
    folder = shared_data / "engabreen"
    frame = SiteFrame("EPSG:32633", 446_000.0, 7_396_000.0)
    dem = Dem.open(folder / "dem_3m_f64.tif").in_frame(frame)
    with (folder / "gcp8902.csv").open() as file:
        points = list(csv.DictReader(file))
    # Matlab counts pixels from 1.
    pixels = np.array([[float(p["u"]) - 1, float(p["v"]) - 1] for p in points])
    surveyed = np.array([[float(p["x_e"]) - 446_000, float(p["y_n"]) - 7_396_000, float(p["z"])] for p in points])

    position = np.array(POSITION) - [446_000.0, 7_396_000.0, 0.0]
    pose = Pose.from_angles(position, *ANGLES_DEG)
    tracer = TerrainTracer(dem)
    columns, rows = pixels.round().astype(int).T
    directions = CAMERA.rays()[rows, columns] @ pose.rotation.T
    ranges = tracer.trace_rays(position, directions)
    assert np.isfinite(ranges).all()
    error = np.linalg.norm(position + directions * ranges[:, None] - surveyed, axis=1)

    # Some points stand on an edge that this 3 m DEM cuts off: the very ray at them flies past, to the ground behind.
    distance = np.linalg.norm(surveyed - position, axis=1)
    on_dem = np.abs(tracer.trace_rays(position, surveyed - position) - distance) < 5
    print("traced against surveyed, m:", np.round(np.sort(error[on_dem]), 2), "edges:", np.round(error[~on_dem], 1))
    assert on_dem.sum() >= 9
    assert np.median(error) < 2.0
    assert np.median(error[on_dem]) < 1.5
    assert error[on_dem].max() < 8.0
