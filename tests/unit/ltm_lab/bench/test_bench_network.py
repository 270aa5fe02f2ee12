"""The network benchmark's parts: what its towers send are votes that the map takes, each with a stamp of its own."""

from __future__ import annotations

from pathlib import Path

import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2
from typer.testing import CliRunner

from ltm_core.fuel.vote_columns import MAX_BYTES
from ltm_core.site.site_io import load_site
from ltm_core.vision.labels import LabelSet
from ltm_lab.bench.network_site import write_region
from ltm_lab.bench.network_towers import stamped
from ltm_lab.cli.bench import bench
from ltm_msgs_py.pointcloud import msg_to_votes
from ltm_msgs_py.stamp import stamp_of


def test_towers_send_votes_that_the_map_takes(tmp_path: Path) -> None:
    traffic = write_region(tmp_path, towers=2, extent=2400.0, views=2)
    site = load_site(traffic.site)
    grid = site.fuel_geometry(site.open_dem())
    assert list(traffic.messages) == list(site.cameras)
    sizes = []
    for name, pool in traffic.messages.items():
        for cdr in pool:
            stamp = 1_700_000_000_123_456_789 + len(sizes)
            message = deserialize_message(stamped(cdr, stamp), PointCloud2)
            assert stamp_of(message) == stamp
            votes = msg_to_votes(message, grid, LabelSet.load().names, name)
            assert len(votes) > 5
            assert votes.visibility is not None
            assert len(cdr) <= MAX_BYTES
            sizes.append(len(cdr))
    assert traffic.bytes == pytest.approx(sum(sizes) / 4)


@pytest.mark.parametrize("option", ["--towers=ten", "--rates=0", "--towers=1,-5"])
def test_numbers_that_make_no_run_are_refused(option: str) -> None:
    result = CliRunner().invoke(bench, ["network", option])
    assert result.exit_code == 2
    assert "numbers" in result.output
