from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from scenes.own_disk import run_on_own_disk
from scenes.small_site import SmallSite

pytestmark = pytest.mark.graph
PROGRAM = Path(__file__).parent / "full_disk_process.py"


def test_a_site_lives_through_a_full_disk_and_ends_in_order(
    small_site: SmallSite, ros_domain: int, tmp_path: Path
) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    said: dict[str, Any] = run_on_own_disk(PROGRAM, "stopped_while_full", disk, small_site.path)
    assert said["status"] == 0, said["console"]
    assert said["restarts"] == [], "no node died of it"
    assert not any("Traceback" in line or "Logging error" in line for line in said["console"])
    stops = [line for line in said["console"] if "recording stopped" in line]
    assert len(stops) == 1
    assert said["dropped"] > 0
    assert said["counted"] == said["recorded"] > 0, "what was counted is in the bag"
    assert said["stored"] == said["told"] > 0, "what an update told of is in the map"
    assert said["lost"] == []
