import runpy
import sys
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import pytest
import typer

from ltm_core.base.errors import ConfigError
from ltm_core.site.site import Site
from ltm_ros.cli import main
from ltm_ros.launching.graph import CAMERA_NODES, describe


def site(**changes: Any) -> Site:
    content: dict[str, Any] = {
        "name": "ridge",
        "crs": "EPSG:32611",
        "origin": (400000.0, 3800000.0),
        "dem": {"path": "dem.tif"},
        "cameras": {"north": {}, "south": {"image": "raw"}},
    }
    return Site.model_validate(content | changes)


def test_every_camera_has_its_chain_and_the_site_its_map() -> None:
    graph = describe(site(), "/sites/ridge.yaml")
    assert [node.full_name for node in graph] == [
        "/ridge/fuel_map",
        *(f"/ridge/north/{kind}" for kind in CAMERA_NODES),
        *(f"/ridge/south/{kind}" for kind in CAMERA_NODES),
    ]
    depth = graph.node("south/depth")
    assert (depth.module, depth.executable, depth.busy) == ("ltm_ros.nodes.depth", "depth", True)
    assert depth.parameters == {"site": "/sites/ridge.yaml", "camera": "south", "use_sim_time": False}
    assert graph.node("fuel_map").parameters == {"site": "/sites/ridge.yaml", "use_sim_time": False}
    assert all(node.required for node in graph)
    named_twice = describe(site(), "/sites/ridge.yaml", cameras=["north", "north"])
    assert [node.label for node in named_twice] == ["fuel_map", *(f"north/{kind}" for kind in CAMERA_NODES)]


def test_a_camera_with_a_source_is_asked_for_its_pictures_but_not_in_a_replay() -> None:
    source = {"kind": "snapshot", "url": "http://127.0.0.1/snapshot.jpg"}
    calibration = {"width": 320, "height": 180, "hfov_deg": 62.0}
    given = site(cameras={"north": {"source": source, "calibration": calibration}, "south": {}})
    graph = describe(given, "ridge.yaml")
    assert [node.label for node in graph if node.name == "source"] == ["north/source"]
    (asks,) = (process for process in graph.processes if process.label == "sources")
    assert (asks.shared, asks.required, [node.label for node in asks.nodes]) == (True, True, ["north/source"])
    apart = describe(given.model_copy(update={"processes": "node"}), "r.yaml")
    assert not any(process.shared for process in apart.processes)
    for graph in (describe(given, "ridge.yaml", sim_time=True), describe(given, "ridge.yaml", sources=False)):
        assert not [node for node in graph if node.name == "source"]


def test_a_recordings_frames_are_not_shed_unless_somebody_says_so() -> None:
    live, replayed = (describe(site(), "ridge.yaml", sim_time=sim_time) for sim_time in (False, True))
    assert "shed" not in live.node("north/capture").parameters
    assert replayed.node("north/capture").parameters["shed"] is False
    told = describe(site(nodes={"capture": {"shed": True, "drop_repeated": False}}), "ridge.yaml", sim_time=True)
    assert {"shed": True, "drop_repeated": False}.items() <= told.node("north/capture").parameters.items()


def test_parameters_of_the_site_file_reach_the_nodes_of_that_type() -> None:
    nodes = {"capture": {"pose_tolerance": 0.25, "limits": {"size": [3, 4.5]}}, "fuel_map": {"export_path": "on"}}
    graph = describe(site(nodes=nodes), "ridge.yaml", parameters={"capture": {"pose_tolerance": 0.5}})
    for camera in ("north", "south"):
        capture = graph.node(f"{camera}/capture").parameters
        assert capture["pose_tolerance"] == 0.5
        assert capture["limits.size"] == [3.0, 4.5]
    assert graph.node("fuel_map").parameters["export_path"] == "on"
    assert "pose_tolerance" not in graph.node("north/depth").parameters


@pytest.mark.parametrize(
    ("nodes", "message"),
    [
        ({"dept": {"x": 1}}, r"ridge.yaml: nodes: unknown node 'dept'; known nodes: source, capture, depth"),
        ({"depth": {"camera": "north"}}, r"nodes.depth.camera: the graph sets this parameter itself"),
        ({"depth": {"x": None}}, r"nodes.depth.x = None: a parameter is"),
        ({"depth": {"x": []}}, r"nodes.depth.x = \[\]: a parameter is"),
        ({"depth": {"x": [1, "a"]}}, r"nodes.depth.x = \[1, 'a'\]: a parameter is"),
        ({"depth": {"x": [True, 1]}}, r"nodes.depth.x = \[True, 1\]: a parameter is"),
    ],
)
def test_refuses_parameters_that_no_node_can_take(nodes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        describe(site(nodes=nodes), "ridge.yaml")


def test_nodes_of_cameras_share_a_process_where_the_site_says_so() -> None:
    apart, together = (
        describe(site(processes=processes, depth_model="d"), "ridge.yaml", record={"bag": "/b"})
        for processes in ("node", "site")
    )
    assert [process.label for process in apart.processes] == [node.label for node in apart]
    assert [node.full_name for node in together] == [node.full_name for node in apart]
    fuel_map, cameras, recorder = together.processes
    assert (fuel_map.label, cameras.label, recorder.label) == ("fuel_map", "cameras", "recorder")
    assert [node.label for node in cameras.nodes] == [
        f"{camera}/{kind}" for camera in ("north", "south") for kind in (*CAMERA_NODES, "topodepth")
    ]
    assert (cameras.shared, cameras.required, cameras.busy, recorder.required) == (True, True, False, False)
    depth = apart.processes[2]
    assert (depth.label, depth.shared, depth.busy) == ("north/depth", False, True)
    with pytest.raises(ConfigError, match=r"no node 'west/depth' .* it has fuel_map, north/capture"):
        together.node("west/depth")


LAUNCH_FILE = Path(__file__).parents[4] / "ltm_ros/launch/site.launch.py"


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The launch file with classes of `launch` that only keep their arguments."""
    for name in ("", ".actions", ".launch_description_entity", ".substitutions"):
        monkeypatch.setitem(sys.modules, f"launch{name}", MagicMock())
    return runpy.run_path(str(LAUNCH_FILE))


def command_of(launch_file: dict[str, Any], **given: str) -> list[str]:
    """What launch runs, which is `ltm` with these arguments."""
    defaults = {name: value for name, (value, _) in launch_file["ARGUMENTS"].items()}
    assert [name for name, value in defaults.items() if value is None] == ["site"]
    values = defaults | given
    launch_file["LaunchConfiguration"].side_effect = lambda name: MagicMock(perform=lambda _: values[name])
    launch_file["generate_launch_description"]()
    (called,) = launch_file["OpaqueFunction"].call_args_list
    called.kwargs["function"](None)
    python, flag, module, *command = launch_file["ExecuteProcess"].call_args.kwargs["cmd"]
    assert (python, flag, module) == (sys.executable, "-m", "ltm_ros.cli.main")
    return list(command)


@pytest.mark.parametrize(
    ("given", "options"),
    [
        ({}, {}),
        ({"cameras": "south,north", "use_sim_time": "true"}, {"only": ["south", "north"], "sim_time": True}),
        ({"view": "True", "record": "/bags/x"}, {"view": True, "record": Path("/bags/x")}),
        ({"state": "/kept"}, {"state": Path("/kept")}),
    ],
)
def test_launch_runs_what_the_command_line_runs(
    launch_file: dict[str, Any], given: dict[str, str], options: dict[str, Any]
) -> None:
    name, *arguments = command_of(launch_file, site="ridge.yaml", **given)
    commands: Any = typer.main.get_command(main.cli)
    read = commands.commands[name].make_context(name, arguments).params
    usual = {"domain": None, "record": None, "view": False, "sim_time": False, "only": None, "state": None}
    assert name == "run"
    assert {key: value or usual.get(key) for key, value in read.items()} == {
        "site": Path("ridge.yaml")
    } | usual | options
