import numpy as np
import pytest

from ltm_core.base.errors import RegionError
from ltm_core.geometry.camera import Camera
from ltm_core.locating.region import marked_box, marked_pixel, marked_polygon

CAMERA = Camera.from_fov(640, 360, 50.0)


def test_of_a_box_the_lower_edge_counts() -> None:
    mark = marked_box(CAMERA, (100, 50, 180, 90), 2.0, 0.1, smoke=True)
    assert (mark.pixels[:, 1] == 90).all()
    assert mark.pixels[[0, -1], 0].tolist() == [100, 180]
    assert mark.weights == pytest.approx(np.full(len(mark.weights), 1 / len(mark.weights)))
    assert mark.sigmas[0].tolist() == pytest.approx([0.6 * 80 / 16, 4.0])  # a tenth of the height; places overlap


def test_the_foot_of_leaning_smoke_weighs_more_than_its_lee() -> None:
    leaning = np.array([[100, 200], [120, 200], [220, 80], [200, 80]], float)
    smoke, ground = (marked_polygon(CAMERA, leaning, 1.0, 0.0, smoke) for smoke in (True, False))
    assert np.allclose(smoke.pixels, ground.pixels)
    along = smoke.pixels[:, 0]
    expected = np.where(along <= 120, 200, 200 - (along - 120) * 1.2)
    assert smoke.pixels[:, 1] == pytest.approx(expected)
    assert smoke.weights[along < 120].min() > 20 * smoke.weights[-1]
    assert np.ptp(ground.weights) == 0


def test_edges_of_concave_outlines_are_their_lowest() -> None:
    outline = np.array([[10, 10], [50, 10], [50, 60], [30, 20], [10, 40]], float)
    mark = marked_polygon(CAMERA, outline, 0.1, 0.0, smoke=False)
    u, v = mark.pixels.T
    assert v == pytest.approx(np.where(u <= 30, 40 - (u - 10), 20 + (u - 30) * 2))


def test_masks_leave_places_out() -> None:
    mask = np.zeros((360, 640), np.bool_)
    mask[:, :140] = True
    mark = marked_box(CAMERA, (100, 50, 180, 90), 2.0, 0.1, True, mask)
    assert mark.pixels[:, 0].min() == 140
    assert mark.weights.sum() == pytest.approx(1)
    with pytest.raises(RegionError, match="masked"):
        marked_box(CAMERA, (20, 50, 100, 90), 2.0, 0.1, True, mask)
    with pytest.raises(RegionError, match="masked"):
        marked_pixel(CAMERA, (20, 50), 2.0, mask)
    with pytest.raises(RegionError, match="does not fit"):
        marked_pixel(CAMERA, (20, 50), 2.0, mask.T)


@pytest.mark.parametrize(
    ("region", "said"),
    [
        ([(700, 20)], "outside the image"),
        ([(20, -3)], "outside the image"),
        ([(np.nan, 3)], "finite"),
        ([], "1 to 1000 points"),
        ([(0, 0)] * 1001, "1 to 1000 points"),
        ([(700, 20), (800, 20), (750, 60)], "outside the image"),
        ([(70, 320), (90, 320), (80, 359.5)], "lower edge"),
        ([(70, 320), (90, np.inf), (80, 340)], "finite"),
    ],
)
def test_bad_regions_are_told(region: list[tuple[float, float]], said: str) -> None:
    with pytest.raises(RegionError, match=said):
        marked_polygon(CAMERA, np.array(region, float).reshape(-1, 2), 1.0, 0.0, smoke=True)
