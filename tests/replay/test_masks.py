from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes.masked_site import VIEW, hidden_of, hidden_of_view, write_masked_site, write_turning_site
from scenes.small_site import FRAMES, NAME, SmallSite, write_small_site

from ltm_core.depth.topodepth import DepthSource
from ltm_core.depth.unseen_terrain import hidden_at
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.image import msg_to_array, msg_to_depth
from ltm_msgs_py.pointcloud import msg_to_votes
from ltm_ros.recordings.replay.run import ReplayOptions, run_offline
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.topics import (
    DEPTH_IMAGE,
    FUEL_VOTES,
    FUSED_DEPTH,
    FUSED_SIGMA,
    FUSED_SOURCE,
    LABELS_CONFIDENCE,
    LABELS_IMAGE,
    MEASURED_DEPTH,
    MEASURED_SIGMA,
    camera_topic,
)

CAMERAS = ("tower", "mast")


class Results:
    def __init__(self, small: SmallSite, site: Path, bag: Path) -> None:
        self.summaries = run_offline(small.bag, site, ReplayOptions(record=bag), lambda done, total: None)
        self._reader = BagReader(bag, allow_damaged=False)

    def on(self, camera: str, topic: Topic) -> list[Any]:
        found = [self._reader.decode(m) for m in self._reader.messages([camera_topic(NAME, camera, topic)])]
        assert len(found) == FRAMES, (camera, topic.name)
        return found


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> SmallSite:
    return write_small_site(tmp_path_factory.mktemp("masked"))


@pytest.fixture(scope="module")
def masked(small: SmallSite, tmp_path_factory: pytest.TempPathFactory) -> Results:
    return Results(small, write_masked_site(small), tmp_path_factory.mktemp("results") / "masked")


@pytest.fixture(scope="module")
def plain(small: SmallSite, tmp_path_factory: pytest.TempPathFactory) -> Results:
    return Results(small, small.path, tmp_path_factory.mktemp("results") / "plain")


@pytest.mark.parametrize("camera", CAMERAS)
def test_hidden_pixels_are_unlabelled_and_the_others_as_before(masked: Results, plain: Results, camera: str) -> None:
    """Beside the mask a few pixels may differ: the network sees what is hidden filled from its surroundings."""
    hidden = hidden_of(camera)
    for topic, nothing in ((LABELS_IMAGE, 255), (LABELS_CONFIDENCE, 0)):
        for found, before in zip(masked.on(camera, topic), plain.on(camera, topic), strict=True):
            now, was = msg_to_array(found, ("mono8",)), msg_to_array(before, ("mono8",))
            assert (was[hidden] != nothing).any()
            assert (now[hidden] == nothing).all()
            assert (now != was)[~hidden].mean() < 0.02


@pytest.mark.parametrize("camera", CAMERAS)
def test_hidden_pixels_have_no_depth(masked: Results, plain: Results, camera: str) -> None:
    hidden = hidden_of(camera)
    for found, before in zip(masked.on(camera, DEPTH_IMAGE), plain.on(camera, DEPTH_IMAGE), strict=True):
        was = msg_to_depth(before)
        assert np.isfinite(was[hidden]).any()
        np.testing.assert_array_equal(msg_to_depth(found), np.where(hidden, np.float32(np.nan), was))
    for topic in (FUSED_DEPTH, FUSED_SIGMA):
        for message in masked.on(camera, topic):
            assert np.isnan(msg_to_depth(message)[hidden]).all()
    for message in masked.on(camera, FUSED_DEPTH):
        assert not np.isnan(msg_to_depth(message)[~hidden]).all()
    for message in masked.on(camera, FUSED_SOURCE):
        assert (msg_to_array(message, ("mono8",))[hidden] == DepthSource.UNKNOWN).all()
    for topic in (MEASURED_DEPTH, MEASURED_SIGMA):
        for message in masked.on(camera, topic):
            measured = msg_to_depth(message)
            assert np.isnan(measured[hidden_at(hidden, *measured.shape)]).all()


@pytest.mark.parametrize("camera", CAMERAS)
def test_hidden_pixels_do_not_vote(small: SmallSite, masked: Results, plain: Results, camera: str) -> None:
    """The masked camera votes for no further cell, and the pixels that it lacks are the mask's."""
    geometry = small.site.fuel_geometry(small.dem)
    names = ("sky", "grass", "shrub", "tree", "bare", "water", "built")
    frames = [frame for frame in small.frames() if frame.camera_name == camera]
    labels = plain.on(camera, LABELS_IMAGE)
    for frame, found, before, label in zip(
        frames, masked.on(camera, FUEL_VOTES), plain.on(camera, FUEL_VOTES), labels, strict=True
    ):
        votes, was = (msg_to_votes(message, geometry, names, camera) for message in (found, before))
        cells = {(r, c): n.sum() for r, c, n in zip(was.rows, was.cols, was.counts, strict=True)}
        for r, c, n in zip(votes.rows, votes.cols, votes.counts, strict=True):
            assert n.sum() <= cells[r, c]
        depth = small.tracer.trace(frame.camera, frame.pose)
        ids = msg_to_array(label, ("mono8",))
        could = np.isfinite(depth.range) & (ids != 255) & (ids != 0) & hidden_of(camera)
        lost = int(was.counts.sum()) - int(votes.counts.sum())
        assert 0 < lost <= could.sum()
        assert lost > 0.9 * could.sum()


def test_the_mask_of_a_view_hides_in_that_view_alone(small: SmallSite, plain: Results, tmp_path: Path) -> None:
    turning = Results(small, write_turning_site(small), tmp_path / "turning")
    summary = turning.summaries[f"/{NAME}/tower/segmentation"]
    assert summary["dropped"] == "0"
    assert summary["mask"].startswith("no view of the site file has this direction: azimuth 100.0")
    geometry = small.site.fuel_geometry(small.dem)
    names = ("sky", "grass", "shrub", "tree", "bare", "water", "built")
    for number in range(FRAMES):
        hidden = hidden_of_view() if number == VIEW else np.zeros_like(hidden_of_view())
        for topic, nothing in ((LABELS_IMAGE, 255), (LABELS_CONFIDENCE, 0)):
            found, was = (msg_to_array(r.on("tower", topic)[number], ("mono8",)) for r in (turning, plain))
            np.testing.assert_array_equal(found, np.where(hidden, nothing, was), f"{topic.name} {number}")
        depth, was_depth = (msg_to_depth(r.on("tower", DEPTH_IMAGE)[number]) for r in (turning, plain))
        np.testing.assert_array_equal(depth, np.where(hidden, np.float32(np.nan), was_depth))
        votes, before = (
            msg_to_votes(r.on("tower", FUEL_VOTES)[number], geometry, names, "tower") for r in (turning, plain)
        )
        lost = int(before.counts.sum()) - int(votes.counts.sum())
        assert (lost > 1000) == (number == VIEW), f"frame {number} lost {lost} votes"
        assert lost == 0 or number == VIEW


def test_pictures_of_another_size_are_refused_in_words(small: SmallSite, tmp_path: Path) -> None:
    """The camera whose calibration comes as topic: its mask meets its pictures' size only when they come."""
    import yaml
    from PIL import Image

    wrong = np.zeros((90, 160), np.uint8)
    wrong[:9] = 255
    Image.fromarray(wrong).save(small.folder / "small_mask.png")
    content = yaml.safe_load(small.path.read_text())
    content["cameras"]["tower"]["mask"] = "small_mask.png"
    site = small.folder / "wrong_size.yaml"
    site.write_text(yaml.safe_dump(content))
    summaries = run_offline(small.bag, site, ReplayOptions(record=tmp_path / "bag"), lambda done, total: None)
    for node in ("segmentation", "depth"):
        summary = summaries[f"/{NAME}/tower/{node}"]
        assert summary["dropped.config"] == str(FRAMES)
        assert "the mask has 160 x 90 pixels" in summary["reason.config"]
    assert summaries[f"/{NAME}/tower/fuel_votes"]["frames_out"] == "0"
    assert summaries[f"/{NAME}/mast/fuel_votes"]["frames_out"] == str(FRAMES)
