"""Pictures of a traced image."""

from __future__ import annotations

import numpy as np
from scenes.rasters import rough_terrain, standing

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_core.pictures.trace import depth_picture, draw_skyline, map_picture, shaded_view
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND
from ltm_core.tracing.trace_io import cell_counts

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


def test_large_photos_are_drawn_smaller() -> None:
    camera = Camera.from_fov(4500, 90, 60.0)
    pose = Pose.from_angles(standing(DEM, 150, 40, 12.0), 50.0, -14.0, 0.0)
    picture = depth_picture(
        TerrainTracer(DEM, possible=NOTHING_BEYOND).trace(camera, pose), DEM, np.zeros((90, 4500, 3), np.uint8)
    )
    assert picture.shape[1] == 1500


def test_without_a_photo_the_terrain_is_shaded() -> None:
    image = traced()
    view = shaded_view(image, DEM)
    ground = view[np.isfinite(image.range)]
    assert (ground[:, 0] == ground[:, 1]).all()
    assert ground[:, 0].std() > 5
    sky = view[np.isposinf(image.range)]
    assert (sky[:, 2] > sky[:, 0]).all()
    assert depth_picture(image, DEM).shape[1] == 330


def test_no_skyline_where_the_ground_is_unknown() -> None:
    ranges = np.full((6, 4), np.inf, np.float32)
    ranges[3:, :2] = 100.0
    ranges[3:, 2:] = np.nan
    drawn = draw_skyline(np.zeros((6, 4, 3), np.uint8), ranges)
    expected = np.zeros((6, 4), bool)
    expected[2, :2] = True
    np.testing.assert_array_equal(drawn.any(axis=-1), expected)


def test_the_map_marks_what_is_seen() -> None:
    image = traced()
    counts = cell_counts(image)
    seen = map_picture(image, DEM, counts)
    unseen = map_picture(image, DEM, np.zeros_like(counts))
    assert seen.ndim == 3
    assert seen.shape[1] == 1200
    # Seen cells are orange: more red over blue than the bare terrain anywhere has.
    orange = (seen[..., 0].astype(int) - seen[..., 2]) > 110
    assert orange.mean() > 0.02
    assert ((unseen[..., 0].astype(int) - unseen[..., 2]) > 110).mean() < 0.005


def test_a_map_is_drawn_even_when_nothing_is_seen() -> None:
    up = TerrainTracer(DEM, possible=NOTHING_BEYOND).trace(
        CAMERA, Pose.from_angles(standing(DEM, 60, 70, 10.0), 0.0, 80.0, 0.0)
    )
    assert np.isposinf(up.range).all()
    assert map_picture(up, DEM, cell_counts(up)).shape[2] == 3
    assert depth_picture(up, DEM).shape[1] == 330
