import pytest

from ltm_ros.cli.output import outcome, print_nodes, print_table
from ltm_ros.runtime.health import Health, node_rows


def test_verdicts_and_cells_are_counted() -> None:
    fusion, terrain, idle = Health(), Health(), Health()
    for verdict in ("ok", "ok", "ok", "network_unusable"):
        fusion.note(f"verdict.{verdict}")
    fusion.note("unlabelled")
    fusion.gauge("last_verdict", "network_unusable: explains 3 % of the terrain")
    terrain.gauge("cells.seen", 12_345)
    terrain.gauge("cells.removed", 80)
    nodes = {"/a/north/topodepth": fusion, "/a/terrain": terrain, "/a/viewer": idle}
    said = outcome({name: health.summary() for name, health in nodes.items()})
    assert said == [
        ("north/topodepth: verdicts", "network_unusable 1, ok 3"),
        ("north/topodepth: the last that was not ok", "network_unusable: explains 3 % of the terrain"),
        ("north/topodepth: events", "unlabelled 1"),
        ("terrain: cells", "seen 12,345, removed 80"),
    ]


def test_reasons_keep_their_brackets(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    health = Health()
    health.drop("pose", "pose is in frame [odom], expected [map]")
    health.drop("pose", "camera 4 m under the ground")
    print_nodes(node_rows({"/a/north/capture": health.summary()}))
    said = capsys.readouterr().out
    assert "dropped by pose: pose is in frame [odom], expected [map]" in said
    assert "4 m" not in said, "one reason a cause will do, the first"


def test_names_of_files_in_a_table_are_no_markup(capsys: pytest.CaptureFixture[str]) -> None:
    print_table("of [/a].jpg", ("photo", ">size"), [("[/b].jpg", "1"), (("red", "[bold]c.jpg"), "2")])
    said = capsys.readouterr().out
    assert all(name in said for name in ("of [/a].jpg", "[/b].jpg", "[bold]c.jpg"))
