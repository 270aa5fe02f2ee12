"""`ros2 launch ltm site.launch.py site:=SITE.yaml`: the graph that `ltm run` starts, under launch."""

import tempfile
from pathlib import Path
from typing import List  # noqa: UP035 - launch_ros compares with typing.List

from launch import LaunchContext, LaunchDescription, logging
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.launch_description_entity import LaunchDescriptionEntity
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue as TypedValue

from ltm_core.base.errors import ConfigError
from ltm_ros.launching.graph import (
    CAMERAS_PROCESS,
    PACKAGE,
    NodeSpec,
    ParameterValue,
    ProcessSpec,
    describe,
    nodes_json,
)
from ltm_ros.launching.site_check import Wanted, require_ready
from ltm_ros.runtime.ros_environment import ros_additions, thread_limits

ARGUMENTS = {
    "site": (None, "site file (YAML)"),
    "cameras": ("", "only these cameras, separated by commas (default: all)"),
    "use_sim_time": ("false", "follow /clock, as a replay publishes it"),
    "view": ("false", "serve a live Rerun view on this machine"),
    "record": ("", "folder for a recording of the graph's topics (default: none)"),
}


def generate_launch_description() -> LaunchDescription:
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_render)])


def _render(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    site, cameras = Path(given["site"]), [name for name in given["cameras"].split(",") if name]
    view: dict[str, ParameterValue] | None = {"serve": True} if _boolean("view", given["view"]) else None
    bag = Path(given["record"]).expanduser().resolve() if given["record"] else None
    record: dict[str, ParameterValue] | None = {"bag": str(bag)} if bag else None
    places = {"record": bag} if bag else None
    graph = describe(
        require_ready(site, Wanted(cameras, view, record, folders=places), logging.get_logger("ltm").warning),
        site,
        cameras=cameras,
        sim_time=_boolean("use_sim_time", given["use_sim_time"]),
        view=view,
        record=record,
    )
    environment = [SetEnvironmentVariable(name, value) for name, value in ros_additions().items()]
    return [*environment, *map(_process, graph.processes)]


def _process(spec: ProcessSpec) -> Node:
    return _shared(spec) if spec.shared else _node(spec.nodes[0])


def _shared(spec: ProcessSpec) -> Node:
    # As launch does with parameters, which it could give to one node alone.
    with tempfile.NamedTemporaryFile("w", prefix="launch_ltm_", suffix=".json", delete=False) as file:
        file.write(nodes_json(spec.nodes))
    return Node(
        package=PACKAGE,
        executable=CAMERAS_PROCESS,
        arguments=[file.name],
        additional_env=thread_limits(spec.busy),
        output="both",
        respawn=True,
        respawn_delay=2.0,
    )


def _node(spec: NodeSpec) -> Node:
    # launch reads bare strings as YAML, which makes a camera called `on` a boolean: say the type.
    parameters = {}
    for name, value in spec.parameters.items():
        if isinstance(value, str):
            parameters[name] = TypedValue(value, value_type=str)
        elif isinstance(value, list) and isinstance(value[0], str):
            parameters[name] = TypedValue(value, value_type=List[str])  # noqa: UP006
        else:
            parameters[name] = value
    return Node(
        package=PACKAGE,
        executable=spec.executable,
        name=spec.name,
        namespace=spec.namespace,
        parameters=[parameters],
        remappings=list(spec.remappings),
        additional_env=thread_limits(spec.busy),
        output="both",
        respawn=True,
        respawn_delay=2.0,
    )


def _boolean(name: str, text: str) -> bool:
    """Launch arguments are strings. Raises ConfigError for what is neither true nor false."""
    if text.lower() not in ("true", "false"):
        raise ConfigError(f"launch argument {name}:={text}: take true or false")
    return text.lower() == "true"
