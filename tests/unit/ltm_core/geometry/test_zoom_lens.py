import math

import pytest

from ltm_core.base.errors import CameraError
from ltm_core.geometry.zoom_lens import LensConfig, ZoomPoint


def tangent(zoom: float) -> float:
    """Of half the field of view: the lens that fits ALERTCalifornia's cameras up to zoom 3602."""
    return math.tan(math.radians(31.3)) / (1 + 0.0036 * (zoom - 1))


def hfov(zoom: float) -> float:
    return math.degrees(2 * math.atan(tangent(zoom)))


def points(*zooms: float, **distortion: float) -> tuple[ZoomPoint, ...]:
    return tuple(ZoomPoint(zoom=zoom, hfov_deg=hfov(zoom), **distortion) for zoom in zooms)


def test_between_the_tables_zooms_the_field_of_view_is_met() -> None:
    lens = LensConfig(width=1920, height=1080, zoom=points(1, 300, 1200, 3602)).lens()
    for zoom in (1.0, 17.0, 120.0, 555.0, 900.0, 2500.0, 3602.0):
        camera = lens.camera(zoom)
        assert camera.width / 2 / camera.fx == pytest.approx(tangent(zoom), rel=2e-3)


def test_focal_length_distortion_and_principal_point_follow() -> None:
    table = (ZoomPoint(zoom=0, hfov_deg=60, k1=-0.2, p1=0.001), ZoomPoint(zoom=1, hfov_deg=20, k1=-0.02, p1=0.0))
    lens = LensConfig(width=800, height=450, cx=390.0, zoom=table).lens()
    wide, long = lens.camera(0), lens.camera(1)
    assert wide.hfov_deg == pytest.approx(60, abs=0.1)
    assert wide.distortion == (-0.2, 0.0, 0.001, 0.0, 0.0)
    assert (long.cx, long.cy) == (390.0, 224.5)
    middle = lens.camera(0.4)
    assert wide.fx < middle.fx < long.fx
    assert wide.distortion[0] < middle.distortion[0] < long.distortion[0]


def test_factors_found_at_some_zooms_become_rows_and_reach_the_others() -> None:
    lens = LensConfig(width=1920, height=1080, zoom=points(1, 300, 1200, 3602)).lens()
    scaled = lens.scaled({100.0: 1.02, 1200.0: 0.97})
    for zoom, factor in ((1.0, 1.02), (100.0, 1.02), (1200.0, 0.97), (3602.0, 0.97)):
        assert scaled.camera(zoom).fx == pytest.approx(lens.camera(zoom).fx * factor, rel=1e-6)
    assert 0.97 < scaled.camera(300.0).fx / lens.camera(300.0).fx < 1.02
    assert lens.scaled({}) == lens


def test_a_zoom_beside_the_table_is_refused_with_both_ends() -> None:
    lens = LensConfig(width=1920, height=1080, zoom=points(1, 1200)).lens()
    with pytest.raises(CameraError, match=r"zoom 2000 lies outside the lens's table, 1 to 1200"):
        lens.camera(2000.0)
    assert lens.camera(1201.0) == lens.camera(1200.0)


def test_a_lens_of_one_zoom_has_one_camera() -> None:
    lens = LensConfig(width=640, height=480, zoom=(ZoomPoint(zoom=1, hfov_deg=50),)).lens()
    assert lens.camera(7.0) == lens.camera(1.0)
    assert lens.scaled({7.0: 1.1}).camera(1.0).fx == pytest.approx(1.1 * lens.camera(1.0).fx)


def test_written_and_read_again_it_is_the_same() -> None:
    lens = LensConfig(width=1920, height=1080, zoom=points(1, 300, 1200, k1=-0.1)).lens()
    again = LensConfig.model_validate(lens.config().model_dump()).lens()
    assert again.camera(200.0).fx == pytest.approx(lens.camera(200.0).fx, rel=1e-6)
    assert again.camera(200.0).distortion == lens.camera(200.0).distortion
