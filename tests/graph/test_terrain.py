import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bystander import Bystander
from scenes.small_site import BEGIN_NS, NAME, SmallSite
from scenes.terrain_frames import HOUR, block_cells, built_up, mast_pose, photo_of_depth, write_fusing_site
from scenes.waiting import wait_for

from ltm_msgs_py.cells import msg_to_changed
from ltm_msgs_py.grid import msg_to_classes
from ltm_msgs_py.image import image_to_msg
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.supervisor import RestartPolicy
from ltm_ros.runtime.topics import IMAGE_RAW, TERRAIN_CHANGE, TERRAIN_INFO, TERRAIN_UPDATE, camera_topic, site_topic

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("kernels")]

NODE = f"/{NAME}/terrain"
UPDATE, CHANGE, INFO = (site_topic(NAME, topic) for topic in (TERRAIN_UPDATE, TERRAIN_CHANGE, TERRAIN_INFO))


def running(small: SmallSite, labels: tuple[str, ...], domain: int, **parameters: Any) -> Runner:
    whole = describe(small.site, small.path, parameters={"terrain": parameters})
    return Runner(
        Graph(NAME, tuple(whole.node(label) for label in labels)),
        domain_id=domain,
        console=lambda line: None,
        policy=RestartPolicy(initial_s=0.1, maximum_s=1.0),
    )


def test_photos_become_a_changed_surface(ros_domain: int, tmp_path: Path) -> None:
    """A block stands in the mast's view since the DEM was made: photos go in, the changed surface comes out."""
    (tmp_path / "site").mkdir()
    small = write_fusing_site(tmp_path / "site")
    folder = tmp_path / "kept"
    labels = ("terrain", *(f"mast/{kind}" for kind in ("capture", "depth", "segmentation", "topodepth")))
    photo = photo_of_depth(built_up(small), small.site.camera("mast").calibration.camera(), mast_pose(small))
    images = camera_topic(NAME, "mast", IMAGE_RAW)
    with running(small, labels, ros_domain, folder=str(folder)) as runner, Bystander() as bystander:
        runner.wait_until_ready(300.0)
        bystander.listen(UPDATE, TERRAIN_UPDATE.type)
        bystander.open(images, IMAGE_RAW.type)
        bystander.wait_for_wiring(len(labels))
        for look in range(3):
            bystander.send(images, image_to_msg(photo, "rgb8", BEGIN_NS + look * 2 * HOUR, "mast_optical"))
            wait_for(
                lambda n=look + 1: bystander.count(NODE, "frames") == n,
                f"{look + 1} frames in the terrain",
                lambda: bystander.summaries,
            )
            assert look > 0 or bystander.heard[UPDATE] == [], "one view has changed the map"
        wait_for(lambda: bystander.heard[UPDATE], "an update", lambda: bystander.summaries)
        parts = [msg_to_changed(message)[0] for message in list(bystander.heard[UPDATE])]
        # Who comes late learns of all that has changed.
        bystander.listen(CHANGE, TERRAIN_CHANGE.type, latched=True)
        bystander.listen(INFO, TERRAIN_INFO.type, latched=True)
        wait_for(lambda: bystander.heard[INFO] and bystander.heard[CHANGE], "the latched topics")
        info = json.loads(bystander.heard[INFO][-1].data)
        # The grid goes out at the node's own pace.
        told = int(sum((part.kind > 0).sum() for part in parts) - sum((part.kind == 0).sum() for part in parts))
        wait_for(
            lambda: int((msg_to_classes(bystander.heard[CHANGE][-1])[0] == info["kinds"]["grown"]).sum()) == told,
            f"{told} cells in the latched grid",
        )
        assert {int(v) for v in bystander.dropped(NODE).values()} == set()
    block = block_cells(small)
    rows, cols = (np.concatenate([getattr(part, name) for part in parts]) for name in ("rows", "cols"))
    shifts = np.concatenate([part.shift for part in parts])
    # The test's network sees 48 x 32 pixels, of some 20 m there: it draws the block's outline no finer.
    about = cv2.dilate(block.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(np.bool_)
    assert block[rows, cols].sum() > 10
    assert about[rows, cols].mean() > 0.6
    assert np.median(shifts[block[rows, cols]]) > 5.0
