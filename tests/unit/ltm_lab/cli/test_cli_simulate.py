"""`ltm-lab simulate`: bad scenarios end with the file, the line and the remedy; what it writes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin
from typer.testing import CliRunner

pytest.importorskip("mitsuba", reason="needs the extra `sim`: pip install 'ltm[sim]'")

from PIL import Image

from ltm_core.base.errors import LtmError
from ltm_core.cameras.sensor_pose import phone_camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.raster.raster_io import write_geotiff
from ltm_lab.cli.main import cli
from ltm_lab.simulator.camera_setup import PHONE
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.pose import msg_to_pose
from ltm_ros.recordings.importing.capture_files import CaptureFiles
from ltm_ros.recordings.importing.sensor_logger import read_sensor_logger

SCENARIO = """name: tiny
seed: 3
crs: EPSG:32611
origin: [500000.0, 3700000.0]
image: {width: 48, height: 32}
truth_step: 2
imaging: {samples: 1}
terrain:
  dem: ground.tif
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


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rows, cols = np.mgrid[0:90, 0:100]
    ground = (200 + 0.9 * cols - 0.4 * rows + 3 * np.sin(cols / 5)).astype(np.float32)
    write_geotiff(tmp_path / "ground.tif", ground, GridGeometry(499_700.0, 3_700_500.0, 8.0, 100, 90, "EPSG:32611"))
    with rasterio.open(
        tmp_path / "nowhere.tif", "w", driver="GTiff", width=100, height=90, count=1, dtype="float32",
        transform=from_origin(499_700.0, 3_700_500.0, 8.0, 8.0),
    ) as sink:  # fmt: skip
        sink.write(ground, 1)
    return tmp_path


def simulate(folder: Path, text: str, *more: str) -> None:
    (folder / "tiny.yaml").write_text(text)
    arguments = ["simulate", str(folder / "tiny.yaml"), "--out", str(folder / "out"), *more]
    result = CliRunner().invoke(cli, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        ("mast: 3.0", "z: 100.0", 20, r"cameras\.0: walker stands at 100\.00 m, .* under the ground.*give z above"),
        ("dem: ground.tif", "dem: nowhere.tif", 9, r"terrain\.dem: .*has no CRS.*gdal_edit"),
        ("dem: ground.tif", "dem: lost.tif", 9, r"terrain\.dem: .*lost\.tif: not a raster"),
        ("surroundings: 512.0", "surroundings: 900.0", 9, r"terrain\.dem: .*no elevation in .*move `origin`"),
        ("size: 240.0", "size: 900.0", 11, r"terrain\.surroundings is 512 m, narrower than the site of 900 m"),
        ("to: conifer", "to: sequoia", 18, r"'conifer', 'oak', 'shrub', 'grass' or 'bare'.*sequoia"),
        ("220, 220]", "220, 250]", 18, r"changes\.0 .*outside the site.*draw it inside"),
        ("{detail_radius", "{fuel: ground2.tif, detail_radius", 13, r"vegetation\.fuel: .*ground2\.tif: not a raster"),
        (
            "to: conifer, mask: {box: [20, 120, 220, 220]",
            "to: conifer, mask: {box: [20, 120, 220, 220]}}\n"
            "  - {kind: cut, depth: -9.0, years: 0.5, mask: {box: [90, 40, 150, 90]",
            21,
            r"cameras\.0: camera walker is .* under the ground that changes.*raise its mast",
        ),
    ],
)  # fmt: skip
def test_bad_scenarios_are_refused(folder: Path, old: str, new: str, line: int, says: str) -> None:
    assert old in SCENARIO
    with pytest.raises(LtmError, match=says) as caught:
        simulate(folder, SCENARIO.replace(old, new))
    assert f"tiny.yaml:{line}: " in str(caught.value)
    assert not list((folder / "out").glob("*.png"))


@pytest.mark.slow
def test_a_phone_s_errors_reach_the_recording(folder: Path) -> None:
    """Of two dates the first is wanted as rasters alone; the recording tells what sensors said, and the truth."""
    simulate(folder, SCENARIO, "--bag", str(folder / "bag"))
    index = json.loads((folder / "out/frames.json").read_text())
    assert [f["date"] for f in index["frames"]] == ["after", "after"]
    assert {p.name for p in (folder / "out/truth").iterdir()} >= {"before", "after", "change_before_after.tif"}
    reader = BagReader(folder / "bag")
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


@pytest.mark.slow
def test_a_walk_is_written_as_a_phone_stores_it(folder: Path) -> None:
    """Photos, recording and list are of the frames, the recording's poses those that its sensors reported."""
    text = SCENARIO.partition("dates:")[0] + (
        "walks:\n  - {name: hiker, path: [[60, 60], [90, 70]], stops: 2, photos: 1, azimuth_deg: [10, 40], "
        "portrait: [false, true], geoid_undulation: -35.0}\n"
    )
    simulate(folder, text, "--phone", str(folder / "phone"))
    frames = json.loads((folder / "out/frames.json").read_text())["frames"]
    sizes = [Image.open(path).size for path in sorted((folder / "phone/photos").iterdir())]
    assert sizes == [(48, 32), (48, 32)]  # a portrait is stored on its side
    track = read_sensor_logger(CaptureFiles(folder / "phone/sensor_logger.zip"))
    for frame, turned in zip(frames, (90.0, 0.0), strict=True):
        told = frame["reported"]
        sensed = track.at(told["stamp_ns"], phone_camera(turned))
        assert sensed.pitch_deg == pytest.approx(told["pitch_deg"], abs=0.05)
        assert sensed.altitude == pytest.approx(told["position"][2], abs=0.3)
    assert len((folder / "phone/true_poses.csv").read_text().splitlines()) == 3


def test_the_ground_raster_is_the_ground(folder: Path) -> None:
    simulate(folder, SCENARIO, "--site-only")
    ground = Dem.open(folder / "out/truth/before/ground.tif")
    assert (ground.geometry.resolution, ground.geometry.shape) == (4.0, (60, 60))
    fine = Dem.open(folder / "out/truth/before/bare_earth.tif")
    x, y = fine.geometry.to_map(*np.mgrid[4:236, 4:236])
    np.testing.assert_allclose(fine.elevation[4:236, 4:236], ground.elevation_at(x, y), atol=2e-3)


EVERYTHING = """name: whole
seed: 8
image: {width: 56, height: 36}
truth_step: 2
imaging: {samples: 1, distortion: [-0.08, 0.01, 0.001, -0.001, 0.0]}
terrain: {size: 240.0, surroundings: 512.0, resolution: 4.0, relief: 60.0}
vegetation: {detail_radius: 90.0, grass_radius: 10.0, houses: 3}
lakes: [{x: 120.0, y: 120.0, depth: 1.0, radius: 30.0}]
smoke: [{x: 150.0, y: 190.0, height: 60.0, drift: 50.0, puffs: 40}]
clouds: {cover: 0.5, base: 700.0, depth: 300.0, size: 900.0, veil: 0.3}
dates:
  - {name: before}
  - {name: after, years: 1.0, green: 0.8, clouds: {cover: 1.0, kind: stratus, base: 600.0}}
changes:
  - {kind: burn, years: 0.9, mask: {box: [20, 150, 100, 220]}}
  - {kind: landslide, years: 0.9, depth: 3.0, mask: {circle: [180, 180, 35]}}
cameras:
  - {name: walker, x: 120.0, y: 60.0, mast: 20.0, sensor: phone, patrol: {azimuth_deg: [10], pitch_deg: [4]}}
"""


@pytest.mark.slow
def test_a_seed_gives_every_byte_and_another_another_landscape(folder: Path) -> None:
    """Clouds, smoke, water, houses, changes, a lens and a phone's sensors: what a run leaves is a function of the
    seed."""
    runs: list[dict[str, bytes]] = []
    for seed in (8, 8, 9):
        out = folder / "out"
        simulate(folder, EVERYTHING.replace("seed: 8", f"seed: {seed}"))
        runs.append({str(p.relative_to(out)): p.read_bytes() for p in out.rglob("*") if p.is_file()})
        out.rename(folder / f"out{len(runs)}")
    first, again, other = runs
    assert len([name for name in first if name.endswith("_truth.npz")]) == 2
    assert first.keys() == again.keys() == other.keys()
    assert [name for name in first if first[name] != again[name]] == []
    assert [name for name in first if first[name] == other[name]] == []
