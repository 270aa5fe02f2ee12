"""A real photo's surveyed control points: the fitted camera, and where the traced points lie on the ground."""

from pathlib import Path

import numpy as np

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame, ray_bend
from ltm_core.pose_estimation.points.control_points import ControlPoints
from ltm_core.pose_estimation.points.resection import Resection, resect, traced_errors
from ltm_core.pose_estimation.points.resection_adjustment import Parameter
from ltm_core.pose_estimation.points.resection_io import read_control_points
from ltm_core.raster.dem import Dem
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


def displaced(away: float, azimuth_deg: float, up: float) -> Float64Array:
    turned = np.radians(azimuth_deg)
    return np.add(POSITION, (away * np.sin(turned), away * np.cos(turned), up))


def found_again(points: ControlPoints, starts: list[Float64Array], bend: float) -> int:
    """How many starts end within a metre, and a hundredth of a degree, of where the stated position does."""
    free: tuple[Parameter, ...] = ("focal", "k1", "position")
    wanted = resect(points, STATED, POSITION, free=free, bend=bend)
    assert wanted.fitted == free
    found = 0
    for start in starts:
        try:
            result = resect(points, STATED, start, free=free, bend=bend)
        except PoseError as error:
            print(start, error)
            continue
        off = float(np.linalg.norm(result.pose.position - wanted.pose.position))
        turned = np.abs(np.subtract(result.pose.angles_deg, wanted.pose.angles_deg)).max()
        found += bool(result.fitted == free and off < 1.0 and turned < 0.01)
    return found


def test_a_free_position_is_found_from_far_off(shared_data: Path) -> None:
    points = read_control_points(shared_data / "engabreen" / "gcp8902.csv", FRAME, first_pixel=1.0)
    # The first two stand between the nearest control points; from them nothing, or a pose 2 m off, was found.
    starts = [displaced(300, 225, 0), displaced(250, 225, 0), displaced(300, 180, 80), displaced(110, 270, 80)]
    assert found_again(points, starts, ray_bend(True, 0.13)) == len(starts)
