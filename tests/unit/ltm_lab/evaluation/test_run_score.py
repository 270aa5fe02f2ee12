import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from std_msgs.msg import String

from ltm_core.base.errors import RecordingError
from ltm_core.fuel.class_map import write_fuel_map
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.vision.labels import LabelSet
from ltm_lab.evaluation.dated_run import DatedRun
from ltm_lab.evaluation.run_score import score_bag
from ltm_lab.evaluation.score_tables import as_json, tables
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.grid import classes_to_msg
from ltm_msgs_py.image import depth_to_msg, image_to_msg
from ltm_msgs_py.pointcloud import columns_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.demo.score import SHARED, TRUTHS

CAMERA = Camera(18, 10, 20.0, 21.0, 8.5, 4.5)
STEP = 2
POSE = Pose.from_angles((10.0, 20.0, 30.0), 45.0, -5.0)
GRID = GridGeometry(0.0, 120.0, 30.0, 5, 4)
SECOND = 1_000_000_000


def depth_image() -> np.ndarray:
    """Sky in the two upper rows, then ground that comes nearer."""
    depth = np.repeat(np.linspace(900, 60, 10, dtype=np.float32)[:, None], 18, axis=1)
    depth[:2] = np.inf
    return depth


def labels_image() -> np.ndarray:
    labels = np.where(np.isinf(depth_image()), 0, 1).astype(np.uint8)
    labels[6:, :9] = 3
    return labels


@pytest.fixture
def recorded(tmp_path: Path) -> DatedRun:
    """One camera with traced and fused depth, labels and truth; another whose frame has truth alone."""
    truth = depth_image()[::STEP, ::STEP]
    true_labels = labels_image()[::STEP, ::STEP].copy()
    true_labels[4, :2] = 2
    with BagWriter(tmp_path / "run/recording") as bag:
        for camera in ("north", "east"):
            for stamp in (5 * SECOND, 6 * SECOND):
                messages: dict[str, Any] = {
                    "camera_info": camera_to_msg(CAMERA, stamp, "c"),
                    "pose": pose_to_msg(POSE, stamp),
                    "truth/camera_info": camera_to_msg(CAMERA.scaled(STEP), stamp, "c"),
                    "truth/depth": depth_to_msg(truth, stamp, "c"),
                    "truth/ground_depth": depth_to_msg(truth + 3, stamp, "c"),
                    "truth/labels": image_to_msg(true_labels, "mono8", stamp, "c"),
                }
                if camera == "north":
                    messages |= {
                        "depth/image": depth_to_msg(depth_image() + 3, stamp, "c"),
                        "fused/depth": depth_to_msg(depth_image() - 1, stamp, "c"),
                        "labels/image": image_to_msg(labels_image(), "mono8", stamp, "c"),
                    }
                for topic, message in messages.items():
                    late = 200_000_000 if topic.startswith(("depth", "fused")) and stamp == 6 * SECOND else 0
                    bag.write(f"/ridge/{camera}/{topic}", message, stamp + late)
        classes = np.full(GRID.shape, 255, np.uint8)
        classes[0], classes[1] = 1, 3
        bag.write("/ridge/fuel_map", classes_to_msg(classes, GRID, 6 * SECOND), 6 * SECOND)
    (tmp_path / "run/site.yaml").write_text(
        "name: ridge\ncrs: EPSG:32611\norigin: [501000, 2000]\ndem: {path: dem.tif}\ncameras: {north: {}, east: {}}\n"
    )
    true_classes = np.full(GRID.shape, 1, np.uint8)
    true_classes[3] = 255
    write_fuel_map(
        tmp_path / "run/fuel_truth.tif", true_classes, GRID.translated(501_000, 2000, "EPSG:32611"), LabelSet.load()
    )
    return DatedRun.find(tmp_path / "run/recording")


def test_every_part(recorded: DatedRun) -> None:
    score = score_bag(recorded)
    assert score.frames == 4
    rows = {(row.source, row.against): row for row in score.depth}
    assert set(rows) == {(s, a) for s in ("traced", "fused") for a in (*TRUTHS, SHARED)}
    traced, fused = rows["traced", "visible surface"], rows["fused", "visible surface"]
    assert (traced.frames, traced.coverage) == (2, 1.0)
    assert (traced.scores[-1].pixels, traced.scores[-1].bias) == (2 * 4 * 9, pytest.approx(3, abs=1e-4))
    assert fused.scores[-1].rmse == pytest.approx(1, abs=1e-4)
    assert rows["traced", "bare ground"].scores[-1].rmse == pytest.approx(0, abs=1e-4)
    assert score.labels is not None
    assert score.labels.pixels == 2 * 5 * 9
    assert score.labels.confusion[2, 3] == 2 * 2
    assert score.labels.right.sum() == score.labels.pixels - 4
    lines = dict(score.skylines)
    # Truth's first row below the sky is its second, row 2 of the image: the line lies at 1.5 to 2, taken as 1.5.
    assert (lines["labels"].columns, lines["labels"].bias, lines["traced"].bias) == (18, 0.5, 0.5)
    assert score.fuel is not None
    assert (score.fuel.seen, score.fuel.right, score.fuel.confusion[1, 3]) == (10, 5, 5)
    assert {(row.topic, row.max_ms) for row in score.latency} == {("depth/image", 200.0), ("fused/depth", 200.0)}
    assert [reason.split(":")[0] for reason in score.lacking] == ["depth, network", "terrain"]


def test_sources_compare_on_the_pixels_that_all_have(recorded: DatedRun) -> None:
    rows = {row.source: row for row in score_bag(recorded).depth if row.against == SHARED}
    assert set(rows) == {"traced", "fused"}
    for source, bias in (("traced", 3), ("fused", -1)):
        whole = rows[source].scores[-1]
        assert (whole.pixels, whole.bias) == (2 * 4 * 9, pytest.approx(bias, abs=1e-4))


def test_terrain_and_dates(recorded: DatedRun, tmp_path: Path) -> None:
    grid = GridGeometry(0.0, 20.0, 2.0, 12, 10)
    folder = recorded.truth / "truth"
    before = np.full((20, 24), 100.0, np.float32)
    after = before.copy()
    after[4:8, 6:12] += 6  # 2 x 3 cells of the terrain's grid
    after[15, 20] += 4  # a quarter of a cell: its mean moves 1 m, below the threshold
    for date, surface in (("before", before), ("after", after)):
        (folder / date).mkdir(parents=True)
        Dem(surface, GridGeometry(501_000.0, 2020.0, 1.0, 24, 20, "EPSG:32611")).save(folder / date / "surface.tif")
    Dem(after - before, GridGeometry(501_000.0, 2020.0, 1.0, 24, 20, "EPSG:32611")).save(
        folder / "change_before_after.tif"
    )
    kinds = np.zeros(grid.shape, np.uint8)
    kinds[2, 3:6], kinds[9, 0] = 2, 1  # three of the six, and a false alarm
    kinds[0] = 255
    rows, cols = np.nonzero(kinds % 255)
    x, y = grid.to_map(rows, cols)
    columns = {
        "x": x.astype(np.float32),
        "y": y.astype(np.float32),
        "z": np.array([105, 105, 107, 98], np.float32),
        "shift": np.array([5, 5, 7, -2], np.float32),
    }
    with BagWriter(tmp_path / "dated") as bag:
        bag.write("/ridge/terrain/update", columns_to_msg(columns, 7), 7)
        bag.write("/ridge/terrain/change", classes_to_msg(kinds, grid, 8), 8)
        bag.write("/ridge/terrain/info", String(data=json.dumps({"threshold": 1.5})), 8)
    with pytest.raises(RecordingError, match="after, before: give the bag's date with --date"):
        DatedRun.find(tmp_path / "dated", recorded.site_path)
    with pytest.raises(RecordingError, match="no truth of 'later'"):
        DatedRun.find(tmp_path / "dated", recorded.site_path, date="later")
    score = score_bag(DatedRun.find(tmp_path / "dated", recorded.site_path, date="after"))
    assert score.terrain is not None
    change = score.terrain.change
    assert change is not None
    assert (change.hits, change.misses, change.false_alarms, change.cells) == (3, 3, 1, 9 * 12)
    assert score.terrain.updated.rmse == pytest.approx(np.sqrt((1 + 1 + 1 + 4) / 4))
    assert score.terrain.reference.rmse == pytest.approx(np.sqrt(3 * 36 / 4))
    assert {"change", "surface"} <= {table.title for table in tables(score)}
    assert as_json(score)["terrain"]["change"]["hits"] == 3
