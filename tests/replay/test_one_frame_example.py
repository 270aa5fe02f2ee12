import importlib.util
import sys
from dataclasses import dataclass, fields
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from ltm_core.base.resources import config_path
from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.votes import CellVotes
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.pipeline.stored_fuel import STORE_FILE, open_stored_map
from ltm_core.site.site_io import load_site
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.grid import msg_to_classes
from ltm_msgs_py.image import msg_to_array, msg_to_depth
from ltm_msgs_py.pointcloud import msg_to_votes
from ltm_msgs_py.stamp import stamp_of
from ltm_msgs_py.status import msg_to_values, status_to_msg
from ltm_ros.recordings.replay.run import ReplayOptions, run_offline
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.topics import (
    DEPTH_IMAGE,
    FUEL_MAP,
    FUEL_VOTES,
    FUSED_DEPTH,
    FUSED_INFO,
    FUSED_SIGMA,
    FUSED_SOURCE,
    LABELS_CONFIDENCE,
    LABELS_IMAGE,
    camera_topic,
    site_topic,
)

REPOSITORY = Path(__file__).parents[2]
DEMO = REPOSITORY / "bags/demo"
CAMERA = "tower_north"


@dataclass(frozen=True, eq=False)
class GraphRun:
    """What the graph made of the recording's first frame: its messages, and the fuel map that it keeps."""

    bag: BagReader
    layers: FuelLayers

    def message(self, topic: str) -> Any:
        """The last one of a topic."""
        *_, last = self.bag.messages([topic])
        return self.bag.decode(last)

    def of_camera(self, topic: Topic) -> Any:
        return self.message(camera_topic("demo", CAMERA, topic))


@pytest.fixture(scope="module")
def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("one_frame", REPOSITORY / "examples/one_frame.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def made(example: ModuleType) -> Any:
    return example.one_frame(DEMO / "recording", DEMO / "site.yaml", CAMERA)


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> GraphRun:
    """Half a second of the recording holds the first frame of the first camera, and no other."""
    folder = tmp_path_factory.mktemp("graph")
    (folder / "state").mkdir()
    options = ReplayOptions(duration=0.5, record=folder / "bag", state=folder / "state")
    summaries = run_offline(DEMO / "recording", DEMO / "site.yaml", options, lambda done, total: None)
    assert {name: s["dropped"] for name, s in summaries.items()} == dict.fromkeys(summaries, "0")
    assert summaries["/demo/fuel_map"]["frames"] == "1"
    site = load_site(DEMO / "site.yaml")
    kept = site_evidence_map(site, site.fuel_geometry(site.open_dem()), LabelSet.load(config_path(site.labels)))
    open_stored_map(folder / "state" / STORE_FILE, site, kept).close()
    return GraphRun(BagReader(folder / "bag", allow_damaged=False), kept.layers())


def assert_same(made: object, graphs: object, what: str) -> None:
    """Two records of arrays, each equal to the last bit, NaN where NaN is."""
    for field in fields(made):  # type: ignore[arg-type]
        ours, theirs = getattr(made, field.name), getattr(graphs, field.name)
        if isinstance(ours, np.ndarray):
            np.testing.assert_array_equal(ours, theirs, err_msg=f"{what}.{field.name}")
            assert ours.dtype == theirs.dtype, f"{what}.{field.name}"
        elif field.name == "visibility":
            assert_same(ours, theirs, f"{what}.{field.name}")
        else:
            assert ours == theirs, f"{what}.{field.name}"


def test_depth(made: Any, graph: GraphRun) -> None:
    message = graph.of_camera(DEPTH_IMAGE)
    assert stamp_of(message) == made.frame.stamp_ns
    depth = made.traced.depth()
    assert np.isfinite(depth).mean() > 0.5
    np.testing.assert_array_equal(depth, msg_to_depth(message))


def test_labels(made: Any, graph: GraphRun) -> None:
    for array, topic in ((made.segmentation.labels, LABELS_IMAGE), (made.segmentation.confidence, LABELS_CONFIDENCE)):
        np.testing.assert_array_equal(array, msg_to_array(graph.of_camera(topic), ("mono8",)))
    assert len(np.unique(made.segmentation.labels)) > 3


def test_fused_depth(made: Any, graph: GraphRun) -> None:
    np.testing.assert_array_equal(made.fused.depth, msg_to_depth(graph.of_camera(FUSED_DEPTH)))
    np.testing.assert_array_equal(made.fused.sigma, msg_to_depth(graph.of_camera(FUSED_SIGMA)))
    np.testing.assert_array_equal(made.fused.source, msg_to_array(graph.of_camera(FUSED_SOURCE), ("mono8",)))
    # Verdict, scale and the check of the pose: what the settings of fusion decide even where no pixel shows it.
    said = graph.of_camera(FUSED_INFO)
    assert stamp_of(said) == made.frame.stamp_ns
    assert msg_to_values(said) == msg_to_values(status_to_msg("", 0, made.fused.info()))
    moved = made.fused.depth - np.where(np.isfinite(made.traced.depth()), made.traced.depth(), np.nan)
    assert np.nanmax(np.abs(moved[np.isfinite(moved)])) > 1.0


def test_votes(made: Any, graph: GraphRun) -> None:
    votes: CellVotes = made.votes
    names = LabelSet.load().names
    assert len(votes) > 100
    assert_same(votes, msg_to_votes(graph.of_camera(FUEL_VOTES), votes.geometry, names, CAMERA), "votes")


def test_fuel_map(made: Any, graph: GraphRun) -> None:
    """Each layer of the map that the graph keeps, and the map that it sends."""
    assert (made.layers.evidence > 0).sum() > 100
    assert_same(made.layers, graph.layers, "layers")
    sent, _ = msg_to_classes(graph.message(site_topic("demo", FUEL_MAP)))
    np.testing.assert_array_equal(made.layers.life_form, sent)
