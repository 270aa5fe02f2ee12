import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("mitsuba", reason="needs the extra `sim`: pip install './ltm_lab[sim]'")


from ltm_core.base.errors import LtmError
from ltm_lab.cli.main import cli
from ltm_lab.simulator.camera_setup import PHONE
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.pose import msg_to_pose

SCENARIO = """name: tiny
seed: 3
crs: EPSG:32611
origin: [500000.0, 3700000.0]
image: {width: 48, height: 32}
truth_step: 2
imaging: {samples: 1}
terrain:
  relief: 60.0
  size: 240.0
  surroundings: 512.0
  resolution: 4.0
vegetation: {detail_radius: 100.0, grass_radius: 10.0}
dates:
  - {name: before, frames: false}
  - {name: after, years: 1.0}
changes:
  - {kind: conversion, to: conifer, mask: {box: [20, 120, 220, 220], ragged: 0}}
cameras:
  - {name: walker, x: 120.0, y: 60.0, mast: 3.0, sensor: phone, patrol: {azimuth_deg: [10, 40], pitch_deg: [-8]}}
"""


def simulate(tmp_path: Path, text: str, *more: str) -> None:
    (tmp_path / "tiny.yaml").write_text(text)
    arguments = ["simulate", str(tmp_path / "tiny.yaml"), "--out", str(tmp_path / "out"), *more]
    result = CliRunner().invoke(cli, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("size: 240.0", "size: 900.0", r"terrain\.surroundings is 512 m, narrower than the site of 900 m"),
        ("to: conifer", "to: sequoia", r"'conifer', 'oak', 'shrub', 'grass' or 'bare'.*sequoia.*, line 18"),
        ("220, 220]", "220, 250]", r"changes\.0 .*outside the site.*draw it inside"),
        (
            "to: conifer, mask: {box: [20, 120, 220, 220]",
            "to: conifer, mask: {box: [20, 120, 220, 220]}}\n"
            "  - {kind: cut, depth: -9.0, years: 0.5, mask: {box: [90, 40, 150, 90]",
            r"cameras\.0: camera walker is .* under the ground that changes.*raise its mast",
        ),
    ],
)  # fmt: skip
def test_bad_scenarios_are_refused(tmp_path: Path, old: str, new: str, says: str) -> None:
    assert old in SCENARIO
    with pytest.raises(LtmError, match=says):
        simulate(tmp_path, SCENARIO.replace(old, new))
    assert not list((tmp_path / "out").glob("*.png"))


@pytest.mark.slow
def test_a_phone_s_errors_reach_the_recording(tmp_path: Path) -> None:
    """Of two dates the first is wanted as rasters alone; the recording tells what sensors said, and the truth."""
    simulate(tmp_path, SCENARIO, "--bag", str(tmp_path / "bag"))
    index = json.loads((tmp_path / "out/frames.json").read_text())
    assert [f["date"] for f in index["frames"]] == ["after", "after"]
    assert {p.name for p in (tmp_path / "out/truth").iterdir()} >= {"before", "after", "change_before_after.tif"}
    reader = BagReader(tmp_path / "bag")
    told, true = (
        [(msg_to_pose(m), m.header.stamp) for m in map(reader.decode, reader.messages([f"/tiny/walker/{topic}"]))]
        for topic in ("pose", "truth/pose")
    )
    assert len(told) == len(true) == 2
    for (said, stamp), (was, _), frame in zip(told, true, index["frames"], strict=True):
        assert 1.0 < np.linalg.norm(said.position - was.position) < 40.0
        np.testing.assert_allclose(was.position, frame["position"], atol=1e-6)
        assert stamp.sec * 10**9 + stamp.nanosec - frame["stamp_ns"] == round(PHONE.clock_offset_s * 1e9)
    assert told[0][0].position[2] != true[0][0].position[2]
