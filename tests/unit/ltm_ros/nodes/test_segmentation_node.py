"""segmentation with `label_head: auto`: labels are the chosen head's, and labels/info and diagnostics say which it
is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scenes.networks import COLORS, write_classifier, write_domain_of, write_swapping_head
from scenes.outlets import Kept
from scenes.small_site import BUILT, GRASS, SmallSite, write_small_site

from ltm_core.base.types import UInt8Array
from ltm_core.pipeline.frame_steps import LabellingConfig, TracingConfig
from ltm_core.site.site_io import load_site
from ltm_msgs_py.image import image_to_msg, msg_to_array
from ltm_msgs_py.label_info import msg_to_model
from ltm_ros.archive.content_digest import votes_digest
from ltm_ros.nodes.segmentation import SegmentationConfig, SegmentationHandler
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import LABELS_IMAGE, LABELS_INFO, POSED_IMAGE

MINUTE = 60 * 10**9


def _photo(color: str) -> UInt8Array:
    """Of one colour, with enough of a pattern that it does not pass for a blank picture."""
    rng = np.random.default_rng(1)
    photo = np.full((96, 160, 3), COLORS[color], np.int16) + rng.integers(-30, 31, (96, 160, 1))
    return np.clip(photo, 0, 255).astype(np.uint8)


@pytest.fixture
def site(tmp_path: Path) -> Path:
    small = write_small_site(tmp_path, recording=False)
    network = write_classifier(small.folder, maps=True)
    space = write_domain_of(network, [np.full((40, 70, 3), COLORS["lime"], np.uint8)])
    domain = {"axes": space.checksum, "centre": [2.0, -2.0, 0.0], "spread": 0.5, "sites": 2}
    write_swapping_head(small.folder / "heads" / "swap.yaml", network, domain=domain)
    content = yaml.safe_load(small.path.read_text())
    content["label_heads"], content["cameras"]["mast"] = "heads", {**content["cameras"]["mast"], "label_head": "auto"}
    content["cameras"]["mast"]["judge_pictures"] = False
    small.path.write_text(yaml.safe_dump(content))
    return SmallSite(small.folder).path


def _node(site: Path) -> tuple[SegmentationHandler, Kept, Health]:
    kept, health = Kept(), Health()
    node = SegmentationHandler(SegmentationConfig(site=str(site), camera="mast"), kept, health)
    node.start()
    return node, kept, health


def _send(node: SegmentationHandler, photo: UInt8Array, stamp: int) -> None:
    node.subscriptions[POSED_IMAGE](image_to_msg(photo, "rgb8", stamp, "mast_optical"))


def _most(message: Any) -> int:
    return int(np.bincount(msg_to_array(message, ("mono8",)).ravel()).argmax())


def test_the_head_that_is_chosen_labels_and_is_told_once(site: Path) -> None:
    node, kept, health = _node(site)
    (first,) = kept.on(LABELS_INFO)
    assert "auto of 1 heads" in msg_to_model(first)
    for second in range(3):
        _send(node, _photo("red"), second * 10**9)
    assert [_most(m) for m in kept.on(LABELS_IMAGE)] == [GRASS] * 3  # the head calls red what lime is
    before, after = (msg_to_model(m) for m in kept.on(LABELS_INFO))
    assert before == msg_to_model(first)
    assert ": swap " in after
    assert health.summary()["head"].startswith("swap (log odds: swap ")
    for minute in range(1, 4):
        _send(node, _photo("lime"), minute * MINUTE)
    assert len(kept.on(LABELS_INFO)) == 3
    assert ": landscape" in msg_to_model(kept.on(LABELS_INFO)[-1])
    assert health.summary()["head"].startswith("landscape")


def test_the_same_pictures_give_the_same_labels_again(site: Path) -> None:
    labels = []
    for _ in range(2):
        node, kept, _ = _node(site)
        for k, color in enumerate(["lime", "red", "red", "red", "lime"]):
            _send(node, _photo(color), k * MINUTE)
        labels.append([msg_to_array(m, ("mono8",)) for m in kept.on(LABELS_IMAGE)])
    np.testing.assert_array_equal(labels[0], labels[1])
    assert {int(np.bincount(image.ravel()).argmax()) for image in labels[0]} == {GRASS, BUILT}


def test_what_an_archive_s_votes_hang_on_has_the_heads_that_are_chosen_among(site: Path) -> None:
    def digest() -> str:
        return votes_digest(load_site(site), "mast", TracingConfig(), LabellingConfig())

    before = digest()
    assert digest() == before
    head = site.parent / "heads" / "swap.yaml"
    content = yaml.safe_load(head.read_text())
    content["domain"]["spread"] = 0.6
    head.write_text(yaml.safe_dump(content))
    assert digest() != before
