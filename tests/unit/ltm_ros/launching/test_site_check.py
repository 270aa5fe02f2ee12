import os
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import pytest
import yaml
from scenes.small_site import write_small_site

from ltm_core.base.errors import SiteFinding, SiteVerdict
from ltm_core.raster import prepared_heights_io
from ltm_ros.launching import site_check
from ltm_ros.launching.graph import Wanted
from ltm_ros.launching.site_check import MACHINE, examine, examined_apart, exit_status


def finding(area: str, verdict: SiteVerdict) -> SiteFinding:
    return SiteFinding(area, "x", verdict, "")


@pytest.mark.parametrize(
    ("findings", "status"),
    [
        ([], 0),
        ([finding("terrain", SiteVerdict.OK), finding("cameras", SiteVerdict.DOUBTFUL)], 0),
        ([finding(MACHINE, SiteVerdict.WRONG), finding("terrain", SiteVerdict.OK)], 1),
        ([finding(MACHINE, SiteVerdict.WRONG), finding("fuel", SiteVerdict.WRONG)], 78),
    ],
)
def test_exit_status(findings: list[SiteFinding], status: int) -> None:
    """78 only for what the site file must be mended for: a disk that is full today may have room tomorrow."""
    assert exit_status(findings) == status


@pytest.mark.parametrize(
    ("free", "verdict"), [(50 << 20, SiteVerdict.WRONG), (1 << 30, SiteVerdict.DOUBTFUL), (9 << 30, SiteVerdict.OK)]
)
def test_room_for_what_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free: int, verdict: SiteVerdict
) -> None:
    monkeypatch.setattr(site_check, "free_bytes", lambda folder: free)
    site = write_small_site(tmp_path, recording=False).path
    found = examine(site, {}, {"state": tmp_path / "map"}).findings
    (room,) = [one for one in found if one.name == "state"]
    assert room.verdict is verdict
    assert f"{free / 1e9:.1f} GB free" in room.said
    assert ("free some space" in room.said) is (verdict is not SiteVerdict.OK)


def test_parameters_of_every_node_are_looked_at(tmp_path: Path) -> None:
    """Of the recorder and the viewer too, where they run."""
    site = write_small_site(tmp_path, recording=False).path
    wanted = Wanted(view={"serve": True}, record={"bag": str(tmp_path / "bag")})
    (found,) = [one for one in examine(site, wanted).findings if one.name == "nodes"]
    assert (found.verdict, found.said) == (SiteVerdict.OK, "11 nodes in 4 processes, parameters are valid")
    labels_by_depth = Wanted(parameters={"segmentation": {"model": "landscape_v5_depth"}})
    (found,) = [one for one in examine(site, labels_by_depth).findings if one.name == "nodes"]
    assert found.verdict is SiteVerdict.WRONG
    assert "landscape_v5_depth" in found.said
    wrong = Wanted(record={"bag": str(tmp_path / "bag"), "max_bytes": -7})
    (found,) = [one for one in examine(site, wrong).findings if one.name == "nodes"]
    assert found.verdict is SiteVerdict.WRONG
    assert "nodes.recorder" in found.said
    assert "max_bytes" in found.said


def test_a_check_that_is_killed_is_a_finding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Killed:
        def __init__(self, *arguments: Any, **options: Any) -> None:
            raise BrokenProcessPool("a child was killed")

    monkeypatch.setattr(site_check, "ProcessPoolExecutor", Killed)
    (found,) = examined_apart(tmp_path / "site.yaml", {})
    assert (found.area, found.verdict) == (MACHINE, SiteVerdict.WRONG)
    assert "larger than the memory" in found.said


def test_what_a_source_or_an_alert_lacks_is_doubted_and_keeps_nothing_from_starting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = write_small_site(tmp_path, recording=False)
    content = yaml.safe_load(small.path.read_text())
    content["cameras"]["mast"]["source"] = {"kind": "folder", "path": "drop"}
    del content["cameras"]["mast"]["image"]
    snapshot = {"kind": "snapshot", "url": "https://127.0.0.1/a.jpg", "ca": "camera.pem", "user": "viewer"}
    content["cameras"]["tower"] = content["cameras"]["mast"] | {
        "source": snapshot | {"password": {"environment": "TOWER_PASSWORD"}}
    }
    content["alerts"] = {"webhook": "http://127.0.0.1/", "token": {"environment": "TOWER_PASSWORD"}}
    small.path.write_text(yaml.safe_dump(content))
    monkeypatch.delenv("TOWER_PASSWORD", raising=False)

    def doubts() -> list[str]:
        found = [one for one in examine(small.path, {}).findings if one.name.startswith(("source of", "alerts"))]
        assert exit_status(found) == 0
        return [one.said for one in found if one.verdict is SiteVerdict.DOUBTFUL]

    first = doubts()
    assert len(first) == 4
    assert "TOWER_PASSWORD is not set" in first[1]
    assert "TOWER_PASSWORD is not set" in first[3]
    assert str(tmp_path / "camera.pem") in first[2]
    monkeypatch.setenv("TOWER_PASSWORD", "secret")
    (tmp_path / "drop").mkdir()
    (tmp_path / "camera.pem").touch()
    assert doubts() == []


def test_the_dem_of_a_graph_that_starts_is_prepared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(site_check, "ProcessPoolExecutor", lambda *_, **__: ThreadPoolExecutor(1))
    monkeypatch.setattr(prepared_heights_io, "LEAST_CELLS", 100)
    small = write_small_site(tmp_path, recording=False)

    def said() -> list[str]:
        found = [one for one in examined_apart(small.path, {}) if (one.area, one.name) == (MACHINE, "dem")]
        assert {one.verdict for one in found} <= {SiteVerdict.OK}
        return [one.said for one in found]

    examine(small.path, {})
    raster = small.site.dem.path
    assert not list(raster.parent.glob("*.ltm-heights.npy"))
    (first,) = said()
    (prepared,) = raster.parent.glob("*.ltm-heights.npy")
    assert str(prepared) in first
    assert said() == []

    prepared.unlink()
    monkeypatch.setattr(os, "posix_fallocate", lambda *_: (_ for _ in ()).throw(OSError(30, "Read-only file system")))
    (refused,) = said()
    assert "Read-only file system" in refused
