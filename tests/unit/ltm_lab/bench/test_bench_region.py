"""The region's map after kills of everything: to the bit that of all frames, each once. Needs mosquitto."""

from __future__ import annotations

from pathlib import Path

import pytest
from rclpy.serialization import serialize_message
from scenes.fuel_frames import grid_of, message, write_site
from scenes.mqtt_broker import MOSQUITTO

from ltm_lab.bench.network_site import Traffic
from ltm_lab.bench.region import run_bench, run_region, same_map
from ltm_lab.bench.region_trial import RegionTrial

pytestmark = pytest.mark.skipif(MOSQUITTO is None, reason="needs mosquitto: apt install mosquitto")


def traffic(folder: Path, towers: int) -> Traffic:
    (folder / "traffic").mkdir()
    site = write_site(folder / "traffic")
    grid = grid_of(site)
    messages = {
        f"t{tower}": [bytes(serialize_message(message(10 * tower + view, grid))) for view in range(3)]
        for tower in range(towers)
    }
    return Traffic(site, messages, 370.0, 14_000.0)


def test_after_kills_the_map_is_that_of_all_frames(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    result = run_region(folder, traffic(tmp_path, 2), 60, 3, 3, lambda line: None)
    assert result.equal
    assert (result.stored, sum(result.kills.values())) == (120, 3)
    assert result.dropped == {}


def test_a_map_that_lacks_a_frame_is_not_the_same(tmp_path: Path) -> None:
    folders = [tmp_path / "long", tmp_path / "short"]
    made = traffic(tmp_path, 1)
    maps = []
    for folder, frames in zip(folders, (12, 11), strict=True):
        folder.mkdir()
        with RegionTrial(folder, made, frames) as trial:
            maps.append(trial.expected())
    assert same_map(maps[0], maps[0])
    assert not same_map(*maps)


@pytest.mark.slow
def test_an_hour_of_ten_towers_and_fifty_kills() -> None:
    runs = run_bench(10, 3600, 50, 1, 12_000.0, 4, print)
    calm, killed = runs["calm"], runs["killed"]
    assert calm.equal
    assert killed.equal
    assert sum(killed.kills.values()) == 50
    assert calm.times_real >= 20
