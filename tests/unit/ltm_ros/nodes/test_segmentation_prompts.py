from itertools import count
from pathlib import Path

import numpy as np
import pytest
import yaml
from scenes.outlets import Kept
from scenes.rerun_site import STAMP, chunks
from scenes.worded_network import DEMO, demo_frames, write_worded_network
from std_msgs.msg import String

from ltm_core.base.errors import ConfigError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.vision.labels import Label
from ltm_msgs_py.image import image_to_msg, msg_to_array
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.nodes.segmentation import SegmentationConfig, SegmentationHandler
from ltm_ros.nodes.viewer import ViewerConfig, ViewerHandler
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import LABELS_HEAT, LABELS_IMAGE, PROMPT

pytest.importorskip("tokenizers")

NUMBERS = count()
VOCABULARY = {"sky": ["sky"], "grass": ["meadow"], "shrub": ["chaparral"], "tree": ["conifer"], "bare": ["road"]}


@pytest.fixture(scope="module")
def frame() -> tuple[np.ndarray, np.ndarray]:
    return demo_frames(4)[3]


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_worded_network(tmp_path_factory.mktemp("worded"), demo_frames(3))


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def node(folder: Path, model: str, **vocabulary: list[str]) -> tuple[SegmentationHandler, Kept]:
    content = yaml.safe_load((DEMO / "site.yaml").read_text()) | {"model": model}
    content["dem"]["path"], content["fuel"]["prior"] = str(DEMO / "dem.tif"), str(DEMO / "prior.tif")
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(content | ({"vocabulary": vocabulary} if vocabulary else {})))
    outlet = Kept(LABELS_HEAT)
    return SegmentationHandler(SegmentationConfig(site=str(path), camera="tower_north"), outlet, Health()), outlet


def labelled(handler: SegmentationHandler, outlet: Kept, photo: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the labels and the heat map of the next image."""
    outlet.sent.clear()
    height, width = photo.shape[:2]
    stamp, name = STAMP + next(NUMBERS), "tower_north_optical"
    messages = {
        "posed/image": image_to_msg(photo, "rgb8", stamp, name),
        "posed/camera_info": camera_to_msg(Camera.from_fov(width, height, 50.0), stamp, name),
        "posed/pose": pose_to_msg(Pose.from_angles((0.0, 0.0, 2000.0), 0.0), stamp, "map", np.eye(6)),
    }
    for topic, on_message in handler.subscriptions.items():
        if topic.name in messages:
            on_message(messages[topic.name])
    heat = outlet.on(LABELS_HEAT)
    return msg_to_array(outlet.on(LABELS_IMAGE)[0], ("mono8",)), msg_to_array(heat[0], ("mono8",)) if heat else None


def test_a_prompt_list_changes_live_labels(tmp_path: Path, network: Path, frame: tuple[np.ndarray, np.ndarray]) -> None:
    photo, truth = frame
    swapped = VOCABULARY | {"grass": ["chaparral"], "shrub": ["meadow"]}
    step = photo.shape[0] // truth.shape[0]
    shares = {}
    for name, vocabulary in (("right", VOCABULARY), ("swapped", swapped)):
        handler, outlet = node(tmp_path, str(network), **vocabulary)
        labels, heat = labelled(handler, outlet, photo)
        assert heat is None
        shares[name] = (labels[::step, ::step] == truth)[truth < 7].mean()
    assert shares["right"] > 0.8
    assert shares["swapped"] < 0.55


def test_a_prompt_of_an_operator_gives_heat_and_no_votes(
    tmp_path: Path, network: Path, frame: tuple[np.ndarray, np.ndarray]
) -> None:
    photo, truth = frame
    handler, outlet = node(tmp_path, str(network), **{k: v for k, v in VOCABULARY.items() if k != "tree"})
    before, _ = labelled(handler, outlet, photo)
    topic = next(t for t in handler.subscriptions if t.name == f"/demo/{PROMPT.name}")
    handler.subscriptions[topic](String(data="  downed   trees "))
    labels, heat = labelled(handler, outlet, photo)
    assert heat is not None
    (message,) = outlet.on(LABELS_HEAT)
    np.testing.assert_array_equal(labels, before)
    step = photo.shape[0] // truth.shape[0]
    seen = heat[::step, ::step]
    assert seen[truth == Label.TREE].mean() > 4 * seen[(truth == Label.SHRUB) | (truth == Label.SKY)].mean()

    # An invalid prompt is rejected, and the previous one remains; an empty one ends it.
    with pytest.raises(ConfigError, match="200"):
        handler.on_prompt(String(data="x" * 201))
    np.testing.assert_array_equal(labelled(handler, outlet, photo)[1], heat)
    handler.on_prompt(String(data=""))
    assert labelled(handler, outlet, photo)[1] is None

    # The viewer draws it over the image.
    config = ViewerConfig(site=str(tmp_path / "site.yaml"), save=str(tmp_path / "view.rrd"))
    viewer = ViewerHandler(config, Kept(), Health())
    (show,) = (call for topic, call in viewer.subscriptions.items() if topic.name.endswith("tower_north/labels/heat"))
    show(message)
    viewer.finish()
    (row,) = chunks(tmp_path / "view.rrd")["/map/cameras/tower_north/heat"]
    shown = np.frombuffer(bytes(row["Image:buffer"][0]), np.uint8).reshape(-1, 4)
    assert shown[:, 3].max() > 100
    assert shown[:, 3].min() < 20
