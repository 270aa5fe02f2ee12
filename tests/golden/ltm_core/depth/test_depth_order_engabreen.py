"""A real photo with surveyed control points: which of two is nearer, by traced, network and fused depth."""

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from scenes.depth_order import depth_order

from ltm_core.depth.ground_sampling import ClassPriors
from ltm_core.depth.monocular import DepthNetwork
from ltm_core.depth.topodepth import FusionVerdict, fuse
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.manifest import MODEL_PATH_VARIABLE

STEP = 3
# Angles, focal length and k1 fitted to the control points; the position is the surveyed one.
POSITION = np.array([722.0, 671.0, 770.0])
FULL = Camera(4290, 2856, 6017.0, 6017.0, 2144.5, 1427.5, (-0.1155, 0.0, 0.0, 0.0, 0.0))
ANGLES_DEG = (230.77, -5.79, -0.77)


def test_the_order_of_surveyed_points(shared_data: Path, shared_models: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(MODEL_PATH_VARIABLE, str(shared_models))
    folder = shared_data / "engabreen"
    with (folder / "gcp8902.csv").open() as file:
        points = list(csv.DictReader(file))
    # Matlab counts pixels from 1.
    pixels = np.array([[float(p["u"]) - 1, float(p["v"]) - 1] for p in points]) / STEP
    surveyed = np.array([[float(p["x_e"]) - 446_000, float(p["y_n"]) - 7_396_000, float(p["z"])] for p in points])
    image = cv2.imread(str(folder / "IMG_8902.jpg"))
    assert image is not None
    camera = FULL.scaled(STEP)
    photo = np.ascontiguousarray(cv2.blur(image, (STEP, STEP))[::STEP, ::STEP, ::-1])
    pose = Pose.from_angles(POSITION, *ANGLES_DEG)
    dem = Dem.open(folder / "dem_3m_f64.tif").in_frame(SiteFrame("EPSG:32633", 446_000.0, 7_396_000.0))
    traced = TerrainTracer(dem).trace(camera, pose)
    network = DepthNetwork.open("tcmonodepth").predict(photo, camera)
    fused = fuse(traced, network, photo, None, ClassPriors.of(LabelSet.load()))

    cols, rows = pixels.round().astype(int).T
    true = pose.to_optical(surveyed)[:, 2]
    height, width = network.values.shape
    at_network = network.values[rows * height // camera.height, cols * width // camera.width]
    orders = {
        "traced": depth_order(traced.depth()[rows, cols], true),
        "network": depth_order(-at_network, true),
        "fused": depth_order(fused.depth[rows, cols], true),
    }
    shares = {name: f"{order.right:.2f} of {order.pairs}" for name, order in orders.items()}
    print("pairs in the right order:", shares, "verdict:", fused.verdict.value, fused.reason)
    assert fused.verdict is not FusionVerdict.POSE_SUSPECTED
    assert orders["traced"].pairs > 20
    assert orders["traced"].right > 0.9
    assert orders["fused"].right >= orders["network"].right
