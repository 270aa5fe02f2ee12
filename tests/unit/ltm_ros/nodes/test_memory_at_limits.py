from pathlib import Path

import pytest
import yaml

from ltm_core.geometry.camera import Camera
from ltm_core.site.sections import MessageLimits
from ltm_core.site.site_io import load_site
from ltm_lab.bench.measure import in_own_process, peak_mb
from ltm_lab.bench.memory import commands, make_site, run_command
from ltm_msgs_py.bag.reader import BagReader
from ltm_ros.launching.graph import Graph, NodeSpec, describe
from ltm_ros.recordings.replay.offline import OfflineGraph
from ltm_ros.recordings.replay.run import ReplayOptions, run_offline


@pytest.mark.slow
def test_no_node_needs_a_gigabyte(tmp_path: Path) -> None:
    """Each node takes a recording of frames of 4:3 with as many pixels as are allowed, without DDS."""
    quarter = int((MessageLimits().pixels / 12) ** 0.5)
    make_site(tmp_path, 2000, Camera.from_fov(4 * quarter, 3 * quarter, 60.0))
    site, results = tmp_path / "site.yaml", tmp_path / "results"
    site.write_text(yaml.safe_dump(yaml.safe_load(site.read_text()) | {"terrain": {}}))
    run_command(commands(tmp_path)["import"])
    in_own_process(record, tmp_path / "bag", site, results)
    nodes = [
        node for node in describe(load_site(site), site) if node.label.startswith("east/") or "/" not in node.label
    ]
    peaks = {node.label: in_own_process(peak_of, node, results) for node in nodes}
    assert {"east/capture", "east/depth", "east/segmentation", "east/topodepth", "terrain"} < peaks.keys()
    assert max(peaks.values()) < 1000, peaks


def record(bag: Path, site: Path, results: Path) -> None:
    run_offline(bag, site, ReplayOptions(record=results), lambda done, total: None)


def peak_of(node: NodeSpec, results: Path) -> float:
    """Return the peak memory of a node that takes all its messages of a recording, MB."""
    offline = OfflineGraph(Graph("limits", (node,)))
    reader = BagReader(results)
    for message in reader.messages([topic for topic in reader.topics() if offline.listened(topic)]):
        offline.feed(message.topic, reader.decode(message), message.log_time_ns)
    offline.finish()
    return peak_mb()
