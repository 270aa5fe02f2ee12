"""The benchmark: its peers trace what we trace, its figures add up, and the command says what it leaves out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.tracing import TerrainTracer
from ltm_lab.bench.measure import Cost, least_cost
from ltm_lab.bench.mountains import ridged_terrain
from ltm_lab.bench.peers import PEERS, PeerKind, TracedView
from ltm_lab.bench.summary import growth, rows
from ltm_lab.bench.tracing import SCENES, Measured, bench_pose
from ltm_lab.cli.main import cli


@pytest.mark.parametrize("kind", PEERS, ids=lambda kind: kind.name)
def test_a_peer_sees_what_we_see(kind: PeerKind) -> None:
    if not kind.installed:
        pytest.skip(f"{kind.name} is not installed")
    dem = ridged_terrain(310)
    summit = bench_pose(dem)
    pose = Pose.from_angles(summit.position, summit.angles_deg[0], -35.0, 4.0)
    view = TracedView(Camera.from_fov(83, 61, 60.0), pose)
    theirs = np.asarray(kind.make(dem).prepare(view)(), np.float64).reshape(61, 83)
    traced = TerrainTracer(dem, curvature=False).trace(view.camera, view.pose)
    ours = traced.horizontal() if "march" in kind.name else traced.range
    hit = np.isfinite(theirs) & (theirs < 1e30) & (theirs > 0)
    assert (hit == np.isfinite(ours)).mean() > 0.95
    both = hit & np.isfinite(ours)
    assert both.mean() > 0.2
    assert np.median(np.abs(theirs[both] - ours[both])) < (1.5 if "march" in kind.name else 0.05)


def test_a_larger_raster_holds_the_same_mountains() -> None:
    np.testing.assert_array_equal(ridged_terrain(150).elevation, ridged_terrain(200).elevation[:150, :150])


def test_least_cost_stops_in_time() -> None:
    calls: list[int] = []
    cost = least_cost(lambda: calls.append(sum(range(10**6))), repeats=1000, at_most_s=0.2)
    assert 1 <= len(calls) < 1000
    assert cost.cpu_ms > 0


def test_ratios_and_growth() -> None:
    def result(tracer: str, size: int, **frames: float) -> Measured:
        costs = {name: Cost(ms, ms / 2) for name, ms in frames.items()}
        return Measured(tracer, size, Cost(1e-6 * size**3, 1.0), 5.0, {s.name: costs for s in SCENES})

    results = [
        *(result("ours", n, warm=n**0.5, cold=2 * n**0.5, still=1.0) for n in (1000, 4000)),
        *(result("embreex", n, **{"": 10.0 * n}) for n in (1000, 4000)),
    ]
    table = rows(results, list(SCENES))
    assert len(table) == 2 * len(SCENES)
    row = next(r for r in table if r["size"] == 4000 and r["scene"] == "1080p 60 deg")
    assert row["ratio_embreex_warm"] == pytest.approx(40_000 / 4000**0.5)
    assert row["ratio_embreex_cold"] == pytest.approx(20_000 / 4000**0.5)
    assert row["mitsuba_cpu_ms"] is None
    slopes = growth(table)
    assert slopes["ours"]["frame"] == pytest.approx(0.25)
    assert slopes["embreex"]["frame"] == pytest.approx(0.5)
    assert slopes["embreex"]["setup"] == pytest.approx(1.5)
    assert slopes["embreex"]["pixels"] == pytest.approx(0.0)
    assert "mitsuba" not in slopes


def test_the_command_writes_its_figures(tmp_path: Path) -> None:
    out = tmp_path / "new" / "bench.json"
    ran = CliRunner().invoke(
        cli,
        f"bench trace --sizes 300 --scenes VGA --tracers ours,march,open3d --repeats 1 --json {out}".split(),
    )
    assert ran.exit_code == 0, ran.output
    report: dict[str, Any] = json.loads(out.read_text())
    assert report["conditions"]["cores"] >= 1
    assert {r["scene"] for r in report["rows"]} == {"VGA 60 deg", "VGA 5 deg"}
    for row in report["rows"]:
        assert row["ratio_march_warm"] == pytest.approx(row["march_cpu_ms"] / row["ours_warm_cpu_ms"])
        assert row["ours_cold_cpu_ms"] > 0
    done = {"open3d"} if any(r["open3d_cpu_ms"] for r in report["rows"]) else {s["tracer"] for s in report["skipped"]}
    assert "open3d" in done


@pytest.mark.parametrize(("option", "value"), [("--sizes", "2000,x"), ("--sizes", "20"), ("--scenes", "8K")])
def test_refuses_what_it_cannot_measure(option: str, value: str) -> None:
    ran = CliRunner().invoke(cli, ["bench", "trace", option, value])
    assert ran.exit_code == 2
