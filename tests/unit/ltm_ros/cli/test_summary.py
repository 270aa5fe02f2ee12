"""What `ltm replay` says at its end."""

from __future__ import annotations

from rich.console import Console

from ltm_core.errors import PoseError
from ltm_ros.cli.summary import outcome, print_outcome
from ltm_ros.runtime.health import Health, cause_of


def test_verdicts_cells_and_refusals_are_counted() -> None:
    fusion, terrain, capture, idle = Health(), Health(), Health(), Health()
    for verdict in ("ok", "ok", "ok", "network_unusable"):
        fusion.note(f"verdict.{verdict}")
    fusion.note("unlabelled")
    fusion.gauge("last_verdict", "network_unusable: explains 3 % of the terrain")
    terrain.gauge("cells.seen", 12_345)
    terrain.gauge("cells.removed", 80)
    for height in (3, 4):
        error = PoseError(f"camera {height} m under the ground")
        capture.drop(cause_of(error), str(error))
    capture.drop("too_large", "image of 40 MB")
    nodes = {"/a/north/topodepth": fusion, "/a/terrain": terrain, "/a/north/capture": capture, "/a/viewer": idle}
    said = outcome({name: health.summary() for name, health in nodes.items()})
    assert said == [
        ("north/capture: refused, pose", "2; the last: camera 4 m under the ground"),
        ("north/capture: refused, too_large", "1; the last: image of 40 MB"),
        ("north/topodepth: verdicts", "network_unusable 1 (25%), ok 3 (75%)"),
        ("north/topodepth: the last that was not ok", "network_unusable: explains 3 % of the terrain"),
        ("north/topodepth: noted", "unlabelled 1"),
        ("terrain: cells", "seen 12,345, removed 80"),
    ]


def test_reasons_keep_their_brackets() -> None:
    health, console = Health(), Console(width=120)
    health.drop("pose", "pose is given in frame [odom], wanted [map]")
    with console.capture() as said:
        print_outcome(console, {"/a/north/capture": health.summary()})
    assert "frame [odom], wanted [map]" in said.get()
