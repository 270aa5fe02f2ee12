"""`ltm reprocess --terrain`: both maps are those of the serial offline replay, whatever works the frames."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scenes.small_site import BEGIN_NS, NAME, SmallSite
from scenes.terrain_frames import write_fusing_site
from scenes.terrain_recording import LOOKS, TOWER_HOURS, write_block_recording
from typer.testing import CliRunner

from ltm_core.base.errors import ArchiveError
from ltm_core.pipeline.site_surface import STORE_FILE as TERRAIN_FILE
from ltm_core.pipeline.stored_fuel import STORE_FILE, STORE_KIND, SURFACE_LAYER
from ltm_core.storage.tile_store import TileStore
from ltm_core.surface.change import ChangeKind
from ltm_core.surface.tile_pool import KIND as TERRAIN_KIND
from ltm_ros.archive.reduction import store_digest
from ltm_ros.archive.run import ArchiveOptions, Summary, look_through, run
from ltm_ros.archive.task import Engine, serial
from ltm_ros.cli.main import cli
from ltm_ros.recordings.replay.run import ReplayOptions, run_offline

DAY_NS = 86_400 * 10**9
FRAMES = LOOKS + len(TOWER_HOURS)


def digests(folder: Path) -> tuple[str, str]:
    """Of the fuel map's store and of the terrain's."""
    found = []
    for name, kind in ((STORE_FILE, STORE_KIND), (TERRAIN_FILE, TERRAIN_KIND)):
        with TileStore.open_read_only(folder / name, kind) as store:
            found.append(store_digest(store))
    return found[0], found[1]


def replayed(small: SmallSite, folder: Path) -> tuple[str, str]:
    folder.mkdir()
    summaries = run_offline(small.bag, small.path, ReplayOptions(state=folder), lambda done, total: None)
    assert {one.get("dropped", "0") for one in summaries.values()} == {"0"}
    return digests(folder)


def reprocessed(options: ArchiveOptions, engine: Engine = serial) -> Summary:
    summary = run(look_through(options, lambda done, total: None), engine, lambda done, total: None)
    if options.terrain:
        assert (summary.digest, summary.terrain_digest) == digests(options.out)
    return summary


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> SmallSite:
    site = write_fusing_site(tmp_path_factory.mktemp("block"), recording=False)
    write_block_recording(site, site.bag)
    return site


@pytest.fixture(scope="module")
def expected(small: SmallSite, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    return replayed(small, tmp_path_factory.mktemp("replay") / "state")


@pytest.fixture(scope="module")
def done(small: SmallSite, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Summary]:
    """Results of all frames, a task each, and both maps."""
    out = tmp_path_factory.mktemp("done") / "out"
    options = ArchiveOptions((small.bag,), small.path, out, terrain=True, frames_per_task=1)
    return out, reprocessed(options)


@pytest.fixture
def options(small: SmallSite, done: tuple[Path, Summary], tmp_path: Path) -> ArchiveOptions:
    """Of a copy of these results."""
    shutil.copytree(done[0], tmp_path / "out")
    return ArchiveOptions((small.bag,), small.path, tmp_path / "out", terrain=True, frames_per_task=1)


def edited(small: SmallSite, name: str, change: Callable[[dict[str, Any]], None]) -> Path:
    content = yaml.safe_load(small.path.read_text())
    change(content)
    place = small.folder / name
    place.write_text(yaml.safe_dump(content))
    return place


def test_both_maps_are_those_of_the_offline_replay(
    done: tuple[Path, Summary], options: ArchiveOptions, expected: tuple[str, str]
) -> None:
    summary = done[1]
    assert (summary.digest, summary.terrain_digest) == expected
    assert (summary.worked, summary.terrain_frames, summary.failed) == (FRAMES, FRAMES, 0)
    again = reprocessed(options)
    assert (again.worked, again.digest, again.terrain_digest) == (0, *expected)


def told(folder: Path) -> list[tuple[int, set[int]]]:
    """Day, and kinds of change, of what the terrain told the fuel map."""
    with TileStore.open_read_only(folder / STORE_FILE, STORE_KIND) as store:
        return [(c.stamp_ns // DAY_NS, set((np.asarray(c.new) // 1000).tolist())) for c in store.changes(SURFACE_LAYER)]


def test_the_fuel_map_knows_of_the_block_from_its_day_on(options: ArchiveOptions, expected: tuple[str, str]) -> None:
    """What cameras saw of its cells until the end of that day is void, what they saw on the next counts."""
    without = reprocessed(replace(options, terrain=False))
    assert without.digest != expected[0]
    assert not (options.out / TERRAIN_FILE).exists()
    summary = reprocessed(options)
    assert summary.digest == expected[0]
    days = told(options.out)
    assert days[0][0] == BEGIN_NS // DAY_NS
    assert int(ChangeKind.GROWN) in days[0][1]
    record = json.loads((options.out / "run.json").read_text())
    assert record["terrain"] == {"frames": FRAMES, "digest": expected[1]}
    assert reprocessed(replace(options, terrain=False)).digest == without.digest
    assert not (options.out / TERRAIN_FILE).exists(), "a map of frames alone, beside a terrain that knows more"


def test_a_corrected_pose_measures_that_camera_alone_and_other_rules_of_the_terrain_measure_nothing(
    small: SmallSite, options: ArchiveOptions, expected: tuple[str, str], tmp_path: Path
) -> None:
    def corrected(site: dict[str, Any]) -> None:
        site["cameras"]["mast"]["pose"]["azimuth_deg"] = 48.5

    after = reprocessed(replace(options, site=edited(small, "corrected.yaml", corrected)))
    assert after.worked == LOOKS
    assert after.terrain_digest != expected[1]

    def stricter(site: dict[str, Any]) -> None:
        site["expert"]["terrain"]["confidence"] = 4.0

    other = edited(small, "stricter.yaml", stricter)
    summary = reprocessed(replace(options, site=other))
    assert summary.worked == 0
    state = tmp_path / "state"
    state.mkdir()
    run_offline(small.bag, other, ReplayOptions(state=state), lambda done, total: None)
    assert (summary.digest, summary.terrain_digest) == digests(state) != expected


@pytest.mark.slow
def test_other_constants_of_fusion_measure_anew_and_leave_votes_alone(
    small: SmallSite, options: ArchiveOptions
) -> None:
    votes = {path.name for path in (options.out / "votes").iterdir()}
    measured = {path.name for path in (options.out / "measured").iterdir()}

    def unsure(site: dict[str, Any]) -> None:
        site.setdefault("nodes", {})["topodepth"] = {"angle_sigma_deg": 0.2}

    summary = reprocessed(replace(options, site=edited(small, "unsure.yaml", unsure)))
    assert summary.worked == FRAMES
    assert {path.name for path in (options.out / "votes").iterdir()} == votes
    assert len({path.name for path in (options.out / "measured").iterdir()} - measured) == len(measured)


@pytest.mark.slow
def test_live_nodes_go_on_from_both_stores(
    options: ArchiveOptions, small: SmallSite, expected: tuple[str, str]
) -> None:
    """They take none of their frames again, and the terrain tells the fuel map nothing that it does not know."""
    out = options.out
    summaries = run_offline(small.bag, small.path, ReplayOptions(state=out), lambda done, total: None)
    for node in ("fuel_map", "terrain"):
        assert summaries[f"/{NAME}/{node}"]["dropped.duplicate"] == str(FRAMES)
    assert digests(out) == expected
    with pytest.raises(ArchiveError, match="a node may have continued from it"):
        reprocessed(options)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda site: site.pop("terrain"), "has no section `terrain`"),
        (lambda site: site.pop("depth_model"), "needs depth from a network"),
        (lambda site: site["terrain"].update(trace_confirmed=True), "traces depth to the confirmed surface"),
    ],
)
def test_terrains_that_an_archive_cannot_work_are_refused(
    small: SmallSite, options: ArchiveOptions, change: Callable[[dict[str, Any]], None], said: str
) -> None:
    with pytest.raises(ArchiveError, match=said):
        look_through(replace(options, site=edited(small, "refused.yaml", change)), lambda done, total: None)


def test_command_line(small: SmallSite, tmp_path: Path) -> None:
    command = ["reprocess", str(small.bag), "--site", str(small.path), "--out", str(tmp_path / "out"), "--terrain"]
    tried = CliRunner().invoke(cli, [*command, "--dry-run"], env={"COLUMNS": "160"})
    assert tried.exit_code == 0, tried.output
    assert "measured depth" in tried.output
