"""A real photo's surveyed control points: the fitted camera, and where the traced points lie on the ground."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ltm_core.camera import Camera
from ltm_core.dem import Dem
from ltm_core.geodesy import SiteFrame
from ltm_core.pose_estimation.resection import Resection, resect
from ltm_core.pose_estimation.resection_check import traced_errors
from ltm_core.pose_estimation.resection_io import read_control_points
from ltm_core.tracing import TerrainTracer

FRAME = SiteFrame("EPSG:32633", 446_000.0, 7_396_000.0)
# As the source states them: 30 mm on a sensor of 22.0 x 14.7 mm, 4290 x 2856 pixels; nothing is known of the angles.
POSITION = (722.0, 671.0, 770.0)
STATED = Camera(4290, 2856, 30 / 22.0 * 4290, 30 / 22.0 * 4290, 2144.5, 1427.5)


def fitted(shared_data: Path) -> tuple[Resection, TerrainTracer]:
    folder = shared_data / "engabreen"
    tracer = TerrainTracer(Dem.open(folder / "dem_3m_f64.tif").in_frame(FRAME))
    points = read_control_points(folder / "gcp8902.csv", FRAME, first_pixel=1.0)
    return resect(points, STATED, POSITION, bend=tracer.bend), tracer


def test_resection_with_the_stated_position(shared_data: Path) -> None:
    result, tracer = fitted(shared_data)
    errors = traced_errors(result, tracer)
    seen = errors.visible
    print(
        f"residual median {np.median(result.residual_px):.2f} px; traced: all {np.median(errors.errors):.2f} m, "
        f"{seen.sum()} not hidden {np.median(errors.errors[seen]):.2f} m; {result.sigmas}"
    )
    assert len(result.points.names) == 14
    assert np.median(result.residual_px) <= 3.0
    assert result.residual_px.max() < 6.0
    assert not result.outliers
    assert not result.held
    assert seen.sum() >= 8
    assert np.median(errors.errors) <= 1.5
    assert np.median(errors.errors[seen]) <= 1.0


def test_no_point_decides_alone(shared_data: Path) -> None:
    result, tracer = fitted(shared_data)
    points = result.points
    for left_out in range(0, len(points.names), 3):
        kept = [k for k in range(len(points.names)) if k != left_out]
        names = tuple(points.names[k] for k in kept)
        fewer = type(points)(names, points.places[kept], points.pixels[kept])
        again = resect(fewer, STATED, POSITION, bend=tracer.bend)
        change = np.subtract(again.pose.angles_deg, result.pose.angles_deg)
        sigma = np.array([result.sigmas[name] for name in ("azimuth_deg", "pitch_deg", "roll_deg")])
        assert (np.abs(change) < 4 * sigma).all(), points.names[left_out]
