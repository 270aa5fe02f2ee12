"""The launch file renders the graph that `ltm run` starts. `launch` comes with an apt ROS only: stand-ins record it."""

from __future__ import annotations

import logging
import runpy
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, List  # noqa: UP035

import pytest

from ltm_core.base.errors import ConfigError
from ltm_core.site.site_io import load_site
from ltm_ros.launching import site_check
from ltm_ros.launching.graph import describe, nodes_of_json
from ltm_ros.runtime import ros_environment

LAUNCH_FILE = Path(__file__).parents[4] / "ltm_ros/launch/site.launch.py"
SITE = """
name: ridge
crs: EPSG:32611
origin: [400000.0, 3800000.0]
dem: {path: dem.tif}
cameras: {north: {}, south: {image: raw}}
nodes: {fuel_map: {export_path: "on"}, capture: {tolerance: 0.25, hosts: ["y", "n"]}}
processes: node
"""


@dataclass
class Call:
    args: tuple[Any, ...]
    options: dict[str, Any]


@dataclass
class Context:
    values: dict[str, str] = field(default_factory=dict)


class Configuration:
    def __init__(self, name: str) -> None:
        self.name = name

    def perform(self, context: Context) -> str:
        return context.values[self.name]


def _recorder(kind: str) -> type:
    def begin(self: Call, *args: Any, **options: Any) -> None:
        Call.__init__(self, args, options)

    return type(kind, (Call,), {"__init__": begin})


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    classes = {
        "launch": ("LaunchContext", "LaunchDescription"),
        "launch.actions": ("DeclareLaunchArgument", "OpaqueFunction", "SetEnvironmentVariable"),
        "launch.launch_description_entity": ("LaunchDescriptionEntity",),
        "launch.substitutions": ("LaunchConfiguration",),
        "launch_ros": (),
        "launch_ros.actions": ("Node",),
        "launch_ros.parameter_descriptions": ("ParameterValue",),
    }
    for module_name, names in classes.items():
        module = ModuleType(module_name)
        for name in names:
            setattr(module, name, Configuration if name == "LaunchConfiguration" else _recorder(name))
        monkeypatch.setitem(sys.modules, module_name, module)
    sys.modules["launch"].logging = SimpleNamespace(get_logger=logging.getLogger)  # type: ignore[attr-defined]
    # What it looks at is tested with the command line's; these sites have no DEM.
    monkeypatch.setattr(site_check, "require_ready", lambda path, wanted, tell: load_site(path))
    return runpy.run_path(str(LAUNCH_FILE))


@pytest.fixture
def site_file(tmp_path: Path) -> Path:
    path = tmp_path / "ridge.yaml"
    path.write_text(SITE)
    return path


def rendered(launch_file: dict[str, Any], **given: str) -> list[Any]:
    *arguments, opaque = launch_file["generate_launch_description"]().args[0]
    assert type(opaque).__name__ == "OpaqueFunction"
    defaults = {one.args[0]: one.options["default_value"] for one in arguments}
    assert [name for name, value in defaults.items() if value is None] == ["site"]
    result: list[Any] = opaque.options["function"](Context(defaults | given))
    return result


def plain(parameters: dict[str, Any]) -> dict[str, Any]:
    """Parameters as ROS gets them, once launch has applied the stated types."""
    values = {}
    for name, value in parameters.items():
        if type(value).__name__ == "ParameterValue":
            (content,) = value.args
            assert value.options["value_type"] is (str if isinstance(content, str) else List[str])  # noqa: UP006
            values[name] = content
        else:
            # launch reads bare strings as YAML.
            assert isinstance(value, bool | int | float), f"{name}: {value!r} would change its type"
            values[name] = value
    return values


@pytest.mark.parametrize(
    ("given", "options"),
    [
        ({}, {}),
        ({"cameras": "south", "use_sim_time": "true"}, {"cameras": ["south"], "sim_time": True}),
        ({"view": "True", "record": "/bags/x"}, {"view": {"serve": True}, "record": {"bag": "/bags/x"}}),
    ],
)
def test_renders_the_graph_that_is_described(
    launch_file: dict[str, Any], site_file: Path, given: dict[str, str], options: dict[str, Any]
) -> None:
    graph = describe(load_site(site_file), site_file, **options)
    actions = rendered(launch_file, site=str(site_file), **given)
    nodes = [action.options for action in actions if type(action).__name__ == "Node"]
    assert len(nodes) == len(graph)
    for node, spec in zip(nodes, graph, strict=True):
        assert (node["package"], node["executable"]) == ("ltm", spec.executable)
        assert f"{node['namespace']}/{node['name']}" == spec.full_name
        (parameters,) = node["parameters"]
        assert plain(parameters) == dict(spec.parameters)
        assert node["respawn"] is True
        assert node["additional_env"] == ros_environment.thread_limits(spec.busy)


def test_renders_one_process_for_the_nodes_that_share_it(
    launch_file: dict[str, Any], site_file: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    site_file.write_text(SITE.replace("processes: node", "processes: site"))
    graph = describe(load_site(site_file), site_file, cameras=["south"])
    actions = rendered(launch_file, site=str(site_file), cameras="south")
    nodes = [action.options for action in actions if type(action).__name__ == "Node"]
    assert [node["executable"] for node in nodes] == ["fuel_map", "cameras"]
    (given,) = nodes[1]["arguments"]
    assert nodes_of_json(Path(given).read_text(encoding="utf-8")) == graph.process("cameras").nodes
    assert nodes[1]["additional_env"] == ros_environment.thread_limits(busy=False)
    assert nodes[1]["respawn"] is True


def test_sets_the_transport_profile(
    launch_file: dict[str, Any], site_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in (*ros_environment.PROFILE_VARIABLES, "ROS_AUTOMATIC_DISCOVERY_RANGE"):
        monkeypatch.delenv(name, raising=False)
    actions = rendered(launch_file, site=str(site_file))
    variables = dict(action.args for action in actions if type(action).__name__ == "SetEnvironmentVariable")
    assert Path(variables["FASTRTPS_DEFAULT_PROFILES_FILE"]).name == "fastdds.xml"
    assert variables["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


def test_refuses_a_flag_that_is_neither(launch_file: dict[str, Any], site_file: Path) -> None:
    with pytest.raises(ConfigError, match="launch argument view:=yes: take true or false"):
        rendered(launch_file, site=str(site_file), view="yes")
