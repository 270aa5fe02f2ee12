"""Labels of a real webcam's parts, as a zoomed camera would show them, with and without its terrain."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.pipeline.frame_steps import UnlikelyLabels
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.trace_io import load_picture_config, read_photo
from ltm_core.vision.labels import Label
from ltm_core.vision.segmenter import Segmenter


def test_terrain_takes_sky_from_ground_and_leaves_the_rest(shared_data: Path) -> None:
    known = load_picture_config(shared_data / "finse/f3.yaml")
    frame = SiteFrame("EPSG:32632", 419_000.0, 6_718_000.0)
    dem = Dem.open(shared_data / "finse/dsm_4m_no_crs.tif", crs=frame.crs).in_frame(frame)
    camera, pose = known.calibration.camera(), known.pose.pose(dem, frame)
    photo = read_photo(shared_data / "finse/2019-05-24.jpg", camera)
    terrain, segmenter = UnlikelyLabels(TerrainTracer(dem)), Segmenter.open()
    covariance = np.diag([0.1**2] * 3 + [np.radians(0.1) ** 2] * 3)
    height, width = camera.height // 3, camera.width // 3
    shares = []
    for top, left in [(row * height, col * width) for row in range(3) for col in range(3)]:
        view = np.ascontiguousarray(photo[top : top + height, left : left + width])
        zoomed = replace(camera, width=width, height=height, cx=camera.cx - left, cy=camera.cy - top)
        unlikely = terrain.of(zoomed, pose, covariance)
        ground = cv2.resize(unlikely[Label.SKY].astype(np.uint8), (width, height)) > 0
        before, after = (segmenter.segment(view, unlikely=given).labels for given in ({}, unlikely))
        shares.append([((labels == k) & ground).mean() for k in (Label.SKY, Label.WATER) for labels in (before, after)])
    sky_before, sky_after, water_before, water_after = np.mean(shares, axis=0)
    print(f"sky {sky_before:.2%} -> {sky_after:.2%}, water {water_before:.2%} -> {water_after:.2%}")
    assert sky_after < 0.3 * sky_before
    assert water_after <= water_before + 1e-4  # sky on flat ground may be called water next: one pixel here
