import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scenes.http_camera import running
from scenes.outlets import Kept
from scenes.ptz_camera import FakeHead, Place, ptz_camera
from scenes.small_site import NAME, Frame, paint_at, write_small_site
from scenes.waiting import wait_for

from ltm_core.base.types import UInt8Array
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.zoom_lens import LensConfig, ZoomPoint
from ltm_core.pose_estimation.mount.mount_config import written_mount
from ltm_core.pose_estimation.mount.mount_model import MountModel
from ltm_core.site.site_io import load_site
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.grid import msg_to_classes
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.launching.graph import describe
from ltm_ros.nodes.source import SourceHandler
from ltm_ros.recordings.replay.offline import OfflineGraph
from ltm_ros.runtime.handler import NodeConfig
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import FUEL_MAP, IMAGE_COMPRESSED, SOURCE_INFO, camera_topic, site_topic

VIEWS: tuple[Place, ...] = ((35.0, -13.0, 1.0), (250.0, -11.0, 300.0))
TABLE = (ZoomPoint(zoom=1, hfov_deg=62.0), ZoomPoint(zoom=9999, hfov_deg=2.5))
LENS = LensConfig(width=320, height=180, zoom=TABLE).lens()


def test_from_a_turning_head_to_a_fuel_map(tmp_path: Path) -> None:
    """The head leans by more than a degree, its tilt axis is off, and it zooms: encoders, mount and lens alone tell
    where each picture is."""
    small = write_small_site(tmp_path, recording=False)
    base = small.tower_pose(0.0).position
    model = MountModel(Pose.from_angles(base, 20.0, 1.1, -0.7), math.radians(0.4), np.zeros((7, 7)))
    shown = {
        place: small.photo(Frame("tower", 0, LENS.camera(place[2]), Pose(base, model.rotation(*place[:2]))))
        for place in VIEWS
    }
    noise = np.random.default_rng(3)

    def picture(place: Place) -> UInt8Array:
        view = shown[min(VIEWS, key=lambda known: abs(known[0] - place[0]))].astype(np.int16)
        return np.clip(view + noise.integers(-5, 6, view.shape), 0, 255).astype(np.uint8)

    head, sent = FakeHead(place=VIEWS[0], rate=1e6), Kept()
    with running(ptz_camera(head, picture)) as camera:
        site: dict[str, Any] = yaml.safe_load(small.path.read_text())
        source = {"kind": "snapshot", "url": camera.url(), "every": 0.1}
        mount = written_mount(model, LENS, small.site.frame)
        site["cameras"] = {"tower": {"source": source, "ptz": {"kind": "vapix"}, "mount": mount}}
        small.path.write_text(yaml.safe_dump(site, sort_keys=False))
        node = SourceHandler(NodeConfig(site=str(small.path), camera="tower"), sent, Health())
        node.start()
        for number, place in enumerate(VIEWS):
            head.send(place)
            wait_for(lambda: len(sent.on(IMAGE_COMPRESSED)) >= 3 + 3 * number, "frames", node.health.summary)  # noqa: B023
        node.finish()
    with BagWriter(tmp_path / "bag") as record:
        graph = OfflineGraph(describe(load_site(small.path), small.path, sources=False), record)
        for topic, message in sent.sent:
            if topic != SOURCE_INFO:
                graph.feed(camera_topic(NAME, "tower", topic), message, stamp_of(message))
        graph.finish()
    reader = BagReader(tmp_path / "bag")
    *_, last = reader.messages({site_topic(NAME, FUEL_MAP)})
    classes, grid = msg_to_classes(reader.decode(last))
    truth, seen = paint_at(*grid.to_map(*np.mgrid[: grid.height, : grid.width])), classes != 255
    assert seen.sum() > 20
    assert (classes == truth)[seen].mean() > 0.7
