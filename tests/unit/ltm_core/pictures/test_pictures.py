import numpy as np
import pytest
from scenes.rasters import rough_terrain, standing

from ltm_core.base.errors import RasterError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_core.pictures import (
    RangeScale,
    depth_colors,
    hillshade,
    label_colors,
    overlay_depth,
    overlay_labels,
)
from ltm_core.pictures.fuel_maps import CAMERAS, FuelCanvas
from ltm_core.pictures.legend import SKY_COLOR, UNKNOWN_COLOR, Text, apart, error_colors, scale_colors
from ltm_core.pictures.trace import depth_picture, map_picture
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND
from ltm_core.tracing.trace_io import cell_counts
from ltm_core.vision.labels import LabelSet

LABELS = LabelSet.load()


def plane(rows: int, cols: int, east: float, north: float, resolution: float = 10.0) -> Dem:
    """A tilted plane that rises by `east` and `north` a metre."""
    geometry = GridGeometry(100.0, 900.0, resolution, cols, rows)
    x, y = geometry.to_map(*np.mgrid[:rows, :cols])
    return Dem((50 + east * x + north * y).astype(np.float32), geometry)


def photo(rows: int, cols: int) -> np.ndarray:
    return np.random.default_rng(5).integers(0, 255, (rows, cols, 3)).astype(np.uint8)


def test_range_scale_is_logarithmic_and_keeps_its_ends() -> None:
    scale = RangeScale(10.0, 1000.0)
    np.testing.assert_allclose(scale.fraction([1, 10, 100, 1000, 9e9]), [0, 0, 0.5, 1, 1], atol=1e-6)
    assert np.isnan(scale.fraction([np.nan, np.inf, -np.inf, 0.0, -3.0])).all()
    assert scale.ticks() == [10, 20, 50, 100, 200, 500, 1000]


def test_depth_colours_separate_near_far_sky_and_unknown() -> None:
    ranges = np.array([[30.0, 30_000.0, np.inf], [np.nan, -np.inf, 948.0]], np.float32)
    colors = depth_colors(ranges)
    assert colors.shape == (2, 3, 3)
    assert colors.dtype == np.uint8
    np.testing.assert_array_equal(colors[0, 0], scale_colors()[0])
    np.testing.assert_array_equal(colors[0, 1], scale_colors()[255])
    np.testing.assert_array_equal(colors[0, 2], SKY_COLOR)
    np.testing.assert_array_equal(colors[1, :2], [UNKNOWN_COLOR, UNKNOWN_COLOR])
    assert colors[0, 0].sum() > 2 * colors[0, 1].sum(), "near is bright"


def test_label_colours_follow_the_palette() -> None:
    ids = np.array([[0, 3, 255], [6, 200, 1]], np.uint8)
    colors = label_colors(ids, LABELS, unlabelled=(1, 2, 3))
    np.testing.assert_array_equal(colors[0, 1], LABELS.colors[3])
    np.testing.assert_array_equal(colors[1, 2], LABELS.colors[1])
    np.testing.assert_array_equal(colors[0, 2], (1, 2, 3))
    np.testing.assert_array_equal(colors[1, 1], (1, 2, 3))


def test_overlays_leave_the_photo_where_nothing_is_known() -> None:
    image = photo(30, 44)
    ranges = np.full((30, 44), np.inf, np.float32)
    ranges[20:, 10:] = 500.0
    mixed = overlay_depth(image, ranges)
    np.testing.assert_array_equal(mixed[:20], image[:20])
    assert (mixed[25:, 15:] != image[25:, 15:]).any(axis=-1).mean() > 0.9
    labels = np.full((30, 44), 255, np.uint8)
    labels[:8, 30:] = 2
    mixed = overlay_labels(image, labels, LABELS)
    np.testing.assert_array_equal(mixed[8:], image[8:])
    assert (mixed[:7, 31:43] != image[:7, 31:43]).any(axis=-1).mean() > 0.9


@pytest.mark.parametrize(("east", "north"), [(0.0, 0.0), (0.3, 0.0), (-0.4, 0.2), (0.1, -0.5)])
def test_hillshade_of_a_plane_is_lamberts_cosine(east: float, north: float) -> None:
    shade = hillshade(plane(12, 17, east, north))
    normal = np.array([-east, -north, 1.0]) / np.sqrt(1 + east**2 + north**2)
    expected = 0.0
    for azimuth_deg, weight in ((315, 0.5), (270, 0.2), (0, 0.2), (225, 0.1)):
        a, h = np.deg2rad(azimuth_deg), np.deg2rad(45.0)
        light = np.array([np.sin(a) * np.cos(h), np.cos(a) * np.cos(h), np.sin(h)])
        expected += weight * max(0.0, float(normal @ light))
    np.testing.assert_allclose(shade[1:-1, 1:-1], expected, atol=2e-4)


def test_a_legend_names_the_classes_of_the_shown_part() -> None:
    dem = plane(60, 90, 0.05, 0.02)
    geometry = GridGeometry(220.0, 800.0, 30.0, 12, 8)
    classes = np.full(geometry.shape, 2, np.uint8)
    classes[:, 9:] = 3
    west = (220.0, 560.0, 220.0 + 8 * 30.0, 800.0)
    for bounds, trees in ((west, False), (geometry.bounds, True)):
        legend = FuelCanvas(geometry, dem, (), bounds, width=400).classes(classes, LABELS)[-40:]
        assert (legend == np.array(LABELS.colors[2])).all(axis=-1).any()
        assert (legend == np.array(LABELS.colors[3])).all(axis=-1).any() == trees
        values = FuelCanvas(geometry, dem, (), bounds, width=400).scaled(classes, classes > 0, CAMERAS)[-40:]
        assert [bool((values == np.array(color)).all(axis=-1).any()) for color in CAMERAS.colors] == [
            False, True, trees, False, False
        ]  # fmt: skip


def test_names_do_not_cover_each_other() -> None:
    """Two cameras on one mast, and a third just below it."""
    texts: list[Text] = [("north", 100.0, 50.0, "lm"), ("east", 100.0, 50.0, "lm"), ("far", 110.0, 58.0, "lm")]
    placed = apart([*texts, ("alone", 300.0, 50.0, "lm")], 14, 200)
    assert placed[0] == texts[0]
    rows = sorted(y for _, x, y, _ in placed if x < 200)
    assert min(np.diff(rows)) >= 14
    assert placed[3] == ("alone", 300.0, 50.0, "lm")


CAMERA = Camera.from_fov(330, 210, 60.0)
DEM = rough_terrain(51)


def traced() -> RangeImage:
    return TerrainTracer(DEM, possible=NOTHING_BEYOND).trace(
        CAMERA, Pose.from_angles(standing(DEM, 60, 60, 12.0), 270.0, -4.0, 3.0)
    )


def test_the_photo_shows_through_and_its_sky_stays_as_it_is() -> None:
    image = traced()
    photo = np.random.default_rng(0).integers(60, 190, (210, 330, 3), dtype=np.uint8)
    picture = depth_picture(image, DEM, photo)
    assert picture.shape[1] == 330
    assert picture.shape[0] > 210
    sky, ground = np.isposinf(image.range), np.isfinite(image.range)
    skyline = np.zeros_like(sky)
    skyline[:-1] = sky[:-1] & ground[1:]
    assert skyline.any()
    np.testing.assert_array_equal(picture[:210][sky & ~skyline], photo[sky & ~skyline])
    assert (picture[:210][skyline] == 255).all()
    assert np.abs(picture[:210][ground].astype(int) - photo[ground]).mean() > 15


def test_the_map_marks_what_is_seen() -> None:
    image = traced()
    counts = cell_counts(image)
    frame = SiteFrame("EPSG:32632")
    seen = map_picture(image, DEM, counts, "seen", frame)
    unseen = map_picture(image, DEM, np.zeros_like(counts), "seen", frame)
    assert seen.ndim == 3
    assert seen.shape[1] > 1200, "with axes"
    # Seen cells are orange: more red over blue than the bare terrain anywhere has.
    orange = (seen[..., 0].astype(int) - seen[..., 2]) > 110
    assert orange.mean() > 0.02
    assert ((unseen[..., 0].astype(int) - unseen[..., 2]) > 110).mean() < 0.005


def test_error_colors() -> None:
    truth = np.array([[10.0, 10.0, np.inf, np.inf, 10.0]], np.float32)
    estimate = np.array([[10.1, 310.0, np.inf, 50.0, np.nan]], np.float32)
    small, large, sky, missed, unknown = error_colors(estimate, truth)[0].astype(int)
    assert small.sum() < 60 < 400 < large.sum()
    assert tuple(sky) == SKY_COLOR
    assert tuple(missed) == tuple(unknown) == (190, 192, 196)


def test_map_refuses_rasters_that_do_not_fit() -> None:
    dem = plane(20, 30, 0.0, 0.0)
    geometry = GridGeometry(100.0, 900.0, 30.0, 6, 4, "EPSG:32611")
    with pytest.raises(RasterError, match=r"\(4, 5\)"):
        FuelCanvas(geometry, dem).classes(np.zeros((4, 5), np.uint8), LABELS)
    with pytest.raises(RasterError, match="one CRS"):
        FuelCanvas(geometry, Dem(dem.elevation, dem.geometry.translated(0.0, 0.0, "EPSG:25832")))
