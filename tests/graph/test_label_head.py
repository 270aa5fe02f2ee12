"""A camera's head in a living graph: its labels and `labels/info` are the head's, in the process of the site."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from bystander import Bystander
from scenes.networks import write_classifier, write_swapping_head
from scenes.small_site import BUILT, GRASS, NAME, SmallSite, write_small_site
from scenes.waiting import wait_for

from ltm_core.vision.segmenter import Segmenter
from ltm_msgs_py.image import msg_to_array, msg_to_rgb
from ltm_msgs_py.json_topics import msg_to_model
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.topics import IMAGE_RAW, LABELS_IMAGE, LABELS_INFO, camera_topic

pytestmark = pytest.mark.graph


def test_a_camera_s_head_reaches_its_labels(kernels: None, ros_domain: int, tmp_path: Path) -> None:
    (tmp_path / "site").mkdir()
    small = write_small_site(tmp_path / "site", recording=False)
    network = write_classifier(small.folder, maps=True)
    write_swapping_head(small.folder / "heads" / "swap.yaml", network)
    site = yaml.safe_load(small.path.read_text())
    site["label_heads"], site["cameras"]["mast"]["label_head"] = "heads", "swap"
    small.path.write_text(yaml.safe_dump(site))
    small = SmallSite(small.folder)
    whole, lines = describe(small.site, small.path), list[str]()
    graph = Graph(NAME, tuple(whole.node(f"mast/{kind}") for kind in ("capture", "segmentation")))
    images, labels, info = (camera_topic(NAME, "mast", topic) for topic in (IMAGE_RAW, LABELS_IMAGE, LABELS_INFO))
    with Runner(graph, domain_id=ros_domain, log_folder=tmp_path, console=lines.append), Bystander() as seen:
        seen.listen(labels, LABELS_IMAGE.type)
        seen.listen(info, LABELS_INFO.type, latched=True)
        seen.open(images, IMAGE_RAW.type)
        seen.wait_for_wiring(2)
        photo = small.messages()[IMAGE_RAW]
        seen.send(images, photo)
        found = msg_to_array(seen.wait_for_stamp(labels, stamp_of(photo)), ("mono8",))
        wait_for(lambda: seen.heard[info], "labels/info", lambda: lines)
        told = msg_to_model(seen.heard[info][0])
    plain, taught = Segmenter.open(network), Segmenter.open(network, head="swap", heads=small.folder / "heads")
    assert told == taught.described
    np.testing.assert_array_equal(found, taught.segment(msg_to_rgb(photo)).labels)
    usual = plain.segment(msg_to_rgb(photo)).labels
    assert (found == GRASS).sum() > 0.9 * (usual == BUILT).sum() > 0
