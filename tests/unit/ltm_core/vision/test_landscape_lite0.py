"""The default network on real photographs that did not train it, and on ground whose distance is known."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from ltm_core.base.types import UInt8Array
from ltm_core.depth.monocular import DepthNetwork
from ltm_core.fuel.label_errors import known_errors
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.scoring.labels import SegmentationScore
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import Label
from ltm_core.vision.manifest import DEFAULT_MODEL, MODEL_PATH_VARIABLE, NetworkManifest
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.evaluation.metrics.skyline import SkylineTally, skyline
from ltm_lab.resources import lab_config


def _photo(path: Path, size: tuple[int, int]) -> UInt8Array:
    return np.ascontiguousarray(cv2.resize(cv2.imread(str(path)), size, interpolation=cv2.INTER_AREA)[..., ::-1])


def test_the_files_are_small_and_say_how_they_err() -> None:
    manifest = NetworkManifest.find(DEFAULT_MODEL)
    files = {m.model_file() for m in (manifest, NetworkManifest.find(f"{DEFAULT_MODEL}_depth"))}
    assert sum(file.stat().st_size for file in files) < 16e6
    right = known_errors(DEFAULT_MODEL).shares.diagonal()
    assert all(right[k - 1] > 0.3 for k in (Label.GRASS, Label.SHRUB, Label.TREE, Label.BARE))


def test_the_sky_of_held_out_photos_is_that_of_the_sky_network(
    shared_data: Path, shared_models: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(MODEL_PATH_VARIABLE, str(shared_models))
    teacher, ours = Segmenter.open("skyseg_u2netp"), Segmenter.open()
    names = yaml.safe_load(lab_config("training/mountain_photos.yaml").read_text())["held_out"]["photos_test"][::5]
    score, tally = SegmentationScore.empty(2), SkylineTally()
    for name in names:
        photo = _photo(shared_data / "mountain_photos" / "images" / f"{name}.jpg", (512, 341))
        true, found = teacher.segment(photo).labels == Label.SKY, ours.segment(photo).labels == Label.SKY
        score = score.plus(true.astype(np.uint8), found.astype(np.uint8))
        tally.add(skyline(found), skyline(true))
    assert score.iou[1] > 0.95
    assert tally.score().median <= 4.0


def test_near_and_far_are_in_order_on_a_real_glacier(shared_data: Path) -> None:
    """Pairs of pixels whose traced ranges differ by half or more; the photo is of a valley, 60 m to 6 km away."""
    folder = shared_data / "engabreen"
    frame = SiteFrame("EPSG:32633", 446000.0, 7396000.0)
    dem = Dem.open(folder / "dem_3m_f64.tif").in_frame(frame)
    pose = Pose.from_angles((722.0, 671.0, 770.0), 230.77, -5.79, -0.77)
    width, height = 429, 286
    camera = Camera(width, height, 601.7, 601.7, (width - 1) / 2, (height - 1) / 2, (-0.1155, 0.0, 0.0, 0.0, 0.0))
    depth = TerrainTracer(dem).trace(camera, pose).depth()
    # In the size that it was taken in, as a camera's pictures are: one that is made small first is another picture, of
    # which the share differs by up to three hundredths.
    photo = np.ascontiguousarray(cv2.imread(str(folder / "IMG_8902.jpg"))[..., ::-1])
    full = Camera.from_fov(photo.shape[1], photo.shape[0], camera.hfov_deg)  # a relative depth does not look at it
    found = DepthNetwork.open(f"{DEFAULT_MODEL}_depth").predict(photo, full).values
    inverse = cv2.resize(found, (width, height), interpolation=cv2.INTER_LINEAR)
    rows, cols = np.nonzero(np.isfinite(depth))
    rng = np.random.default_rng(0)
    first, second = rng.integers(0, len(rows), (2, 20000))
    ratio = np.log(depth[rows[first], cols[first]] / depth[rows[second], cols[second]])
    clear = np.abs(ratio) > np.log(1.5)
    nearer = np.log(inverse[rows[first], cols[first]] / inverse[rows[second], cols[second]])
    right = np.sign(nearer) == -np.sign(ratio)
    assert clear.sum() > 3000
    assert right[clear].mean() > 0.84  # chance is 0.5; see the card
