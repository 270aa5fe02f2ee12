from dataclasses import replace

import numpy as np
import pytest
from scenes.depth_scene import CAMERA, depth_scene

from ltm_core.depth.expected_surface import expected_surface
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.occlusion_boundaries import refine_occlusion_boundaries
from ltm_core.vision.labels import LabelSet

CLASSES, CONFIG = ClassPriors.of(LabelSet.load()), FusionConfig()


def test_cover_brings_the_surface_nearer_by_its_height() -> None:
    """On a plane the raised surface is known in closed form."""
    rows, _ = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    down = np.maximum((rows - CAMERA.cy) / CAMERA.fy, 1e-9)
    ground = np.where(rows > CAMERA.cy + 20, 50.0 / down, np.inf).astype(np.float32)
    pose = replace(depth_scene().traced.pose, rotation=np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))
    shrubs = np.full(ground.shape, 2, np.uint8)
    cover = np.zeros(256, np.float32)
    cover[2] = 2.0
    surface, sigma = expected_surface(ground, shrubs, cover, CAMERA, pose, 0.0, 0.5, CONFIG)
    part = (rows > CAMERA.cy + 30) & (rows < CAMERA.height - 12)
    np.testing.assert_allclose(surface[part], ground[part] * 48.0 / 50.0, rtol=2e-3)
    # Half a metre of the terrain's height is a hundredth of the camera's, and so of the depth; cover is half unsure.
    expected = np.hypot(0.01 * ground[part], 0.5 * (ground - surface)[part])
    assert np.median(sigma[part] / expected) == pytest.approx(1.0, abs=0.1)


def test_an_edge_moves_to_where_the_photo_has_it() -> None:
    height, width = 200, 240
    rows, cols = np.mgrid[0:height, 0:width]
    crest = (110 + 12 * np.sin(cols / 40.0)).astype(int)
    ground = np.where(rows >= crest, 400.0, 1500.0).astype(np.float32)
    grown = rows >= crest - 5
    rng = np.random.default_rng(6)
    photo = np.where(grown[..., None], (90, 80, 40), (170, 180, 200)) + rng.normal(0, 8, (height, width, 1))
    surface, sigma = ground.copy(), np.full_like(ground, 2.0)
    camera = replace(CAMERA, width=width, height=height, fx=1200.0, fy=1200.0)
    colours = np.clip(photo, 0, 255).astype(np.uint8)
    refine_occlusion_boundaries(colours, surface, sigma, ground, None, CLASSES, camera, CONFIG)
    raised = ((surface == 400.0) & (rows < crest)).sum(axis=0)
    assert (np.abs(raised - 5) <= 1).mean() > 0.9
    strip = grown & (rows < crest)
    assert (surface[strip] == 400.0).mean() > 0.85
    assert (surface[rows < crest - 9] == 1500.0).mean() > 0.99
