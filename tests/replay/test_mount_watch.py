"""Recordings with exact poses through the graph: the watch of their mounts raises no alarm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from ltm_core.site.site_io import load_site
from ltm_ros.recordings.importing.build import import_photos
from ltm_ros.recordings.replay.run import ReplayOptions, run_offline

BAGS = Path(__file__).parents[2] / "bags"


def watched(folder: Path, shipped: Path) -> Path:
    """A shipped site, its poses watched in every picture, without the nodes that this does not need."""
    content: dict[str, Any] = yaml.safe_load(shipped.read_text())
    content["dem"] = {"path": str((shipped.parent / content["dem"]["path"]).resolve())}
    for unused in ("depth_model", "fuel"):
        content.pop(unused, None)
    path = folder / "site.yaml"
    path.write_text(
        yaml.safe_dump(content | {"refine_poses": {"every": 0.0}, "expert": {"refine_poses": {"gather": 3}}})
    )
    return path


@pytest.mark.slow
@pytest.mark.parametrize("name", ["demo", "phone"])
def test_exact_poses_raise_no_alarm(tmp_path: Path, name: str) -> None:
    site, bag = watched(tmp_path, BAGS / name / "site.yaml"), BAGS / name / "recording"
    if name == "phone":
        bag = tmp_path / "true"
        photos = BAGS / name / "photos"
        import_photos([photos], bag, BAGS / name / "true_poses.csv", load_site(site))
    healths = run_offline(bag, site, ReplayOptions(), lambda done, total: None)
    summaries = [healths[f"/{load_site(site).name}/{camera}/pose"] for camera in load_site(site).cameras]
    looked = 0
    for summary in summaries:
        assert "noted.mount.slipped" not in summary
        assert "noted.mount.contradicted" not in summary
        assert summary["dropped"] == "0"
        looked += int(summary.get("noted.clear", 0))
    assert looked >= 6
    assert sum("noted.mount.held" in summary for summary in summaries) >= 1
