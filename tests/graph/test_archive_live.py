"""An archive that is worked again gives the store of the living graph that had seen the same frames."""

from __future__ import annotations

from pathlib import Path

import pytest
from scenes.small_site import FRAMES, NAME, SmallSite

from ltm_core.pipeline.stored_fuel import STORE_FILE, STORE_KIND
from ltm_core.storage.tile_store import TileStore
from ltm_ros.archive.engine import serial
from ltm_ros.archive.reduction import store_digest
from ltm_ros.archive.run import ArchiveOptions, look_through, run
from ltm_ros.recordings.replay.run import ReplayOptions, run_live

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("kernels")]


def test_the_store_of_a_live_run_is_that_of_its_archive(
    small_site: SmallSite, ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ltm_ros.archive.publish.write_page", lambda map_, folder: None)
    (tmp_path / "state").mkdir()
    options = ReplayOptions(state=tmp_path / "state", rate=0.25, domain_id=ros_domain)
    lines: list[str] = []
    summaries = run_live(
        small_site.bag, small_site.path, options, lambda done, total: None, lines.append, tmp_path / "log"
    )
    assert summaries[f"/{NAME}/fuel_map"]["frames_in"] == str(2 * FRAMES)
    planned = look_through(
        ArchiveOptions((small_site.bag,), small_site.path, str(tmp_path / "out")), lambda done, total: None
    )
    made = run(planned, serial, lambda done, total: None)
    with TileStore.open_read_only(tmp_path / "state" / STORE_FILE, STORE_KIND) as store:
        assert store_digest(store) == made.digest
