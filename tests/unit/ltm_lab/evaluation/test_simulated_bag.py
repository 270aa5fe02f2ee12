import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_lab.evaluation.simulated_bag import write_simulated_bag
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.image import compressed_to_rgb, msg_to_array, msg_to_depth
from ltm_msgs_py.pose import msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_msgs_py.stamp import stamp_of

CAMERA = Camera(30, 18, 25.0, 26.0, 14.0, 9.0, (-0.1, 0.02, 0.0, 0.001, 0.0))
STEP = 4
STAMP = 1_700_000_000_123_456_789
SCENE = {"scenario": "ridge", "crs": "EPSG:32611", "origin": [0.0, 0.0], "curvature": True}


@pytest.fixture
def simulated(tmp_path: Path) -> Path:
    """A folder as `ltm-lab simulate` writes it, with one frame of each of two cameras."""
    folder = tmp_path / "frames"
    folder.mkdir()
    entries = []
    shape = (CAMERA.scaled(STEP).height, CAMERA.scaled(STEP).width)
    for number, name in enumerate(("north", "east")):
        image = np.full((18, 30, 3), (200, 60, 20 + number), np.uint8)  # RGB
        cv2.imwrite(str(folder / f"{number:04d}.png"), image[..., ::-1])
        surface = 100 + 321.7 * np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
        surface[0] = np.inf
        np.savez(
            folder / f"{number:04d}_truth.npz",
            range_surface=surface,
            range_ground=surface + 7,
            labels=np.arange(np.prod(shape)).reshape(shape).astype(np.uint8) % 7,
        )
        camera, sampled = (
            {k: getattr(c, k) for k in ("width", "height", "fx", "fy", "cx", "cy", "distortion")}
            for c in (CAMERA, CAMERA.scaled(STEP))
        )
        entries.append(
            {
                "image": f"{number:04d}.png",
                "truth": f"{number:04d}_truth.npz",
                "camera_name": name,
                "stamp_ns": STAMP + number,
                "camera": camera,
                "truth_camera": sampled,
                "position": [10.0, 20.0, 300.0],
                "azimuth_deg": 214.0,
                "pitch_deg": -4.0,
                "roll_deg": 1.5,
            }
        )
    (folder / "frames.json").write_text(json.dumps(SCENE | {"truth_step": STEP, "frames": entries}))
    return folder


def test_a_frame_as_its_messages(simulated: Path, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    assert write_simulated_bag(simulated, tmp_path / "bag", "ridge", 95, lambda *n: seen.append(n)) == 2
    assert seen == [(1, 2), (2, 2)]
    reader = BagReader(tmp_path / "bag")
    messages: dict[str, Any] = {m.topic: reader.decode(m) for m in reader.messages()}
    assert len(messages) == 16
    assert {stamp_of(m) for t, m in messages.items() if t.startswith("/ridge/north/")} == {STAMP}
    of = {topic.removeprefix("/ridge/north/"): m for topic, m in messages.items() if topic.startswith("/ridge/north/")}
    assert msg_to_camera(of["camera_info"]) == CAMERA
    assert msg_to_camera(of["truth/camera_info"]) == CAMERA.scaled(STEP)
    np.testing.assert_allclose(msg_to_pose(of["pose"]).angles_deg, [214.0, -4.0, 1.5])
    assert np.abs(compressed_to_rgb(of["image_raw/compressed"]).astype(int) - [200, 60, 20]).max() < 8
    with np.load(simulated / "0000_truth.npz") as truth:
        np.testing.assert_array_equal(msg_to_array(of["truth/labels"]), truth["labels"])
        for topic, name in (("truth/depth", "range_surface"), ("truth/ground_depth", "range_ground")):
            # Ranges became depths along the optical axis, within the rounding that the recording states.
            exact = RangeImage(truth[name], CAMERA.scaled(STEP), Pose.from_angles((0, 0, 0), 0)).depth()
            assert np.isinf(exact[0]).all()
            np.testing.assert_allclose(msg_to_depth(of[topic]), exact, rtol=6.2e-5)
            assert not np.allclose(truth[name][1:], exact[1:], rtol=1e-3)
