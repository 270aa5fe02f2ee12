"""`ros2 launch ltm site.launch.py site:=SITE.yaml`: run `ltm run`, which describes and supervises the graph."""

import sys
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.launch_description_entity import LaunchDescriptionEntity
from launch.substitutions import LaunchConfiguration

from ltm_core.base.errors import ConfigError

FLAGS = {"use_sim_time": "--sim-time", "view": "--view"}
ARGUMENTS = {
    "site": (None, "site file (YAML)"),
    "cameras": ("", "only these cameras, separated by commas (default: all)"),
    "use_sim_time": ("false", "follow /clock, as a replay publishes it"),
    "view": ("false", "serve a live Rerun view on this machine"),
    "record": ("", "folder for a recording of the graph's topics (default: none)"),
    "state": ("", "folder that keeps fuel map and terrain across restarts (default: the site file's)"),
}


def generate_launch_description() -> LaunchDescription:
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_render)])


def _render(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    command = [sys.executable, "-m", "ltm_ros.cli.main", "run", str(Path(given["site"]).expanduser())]
    command += [f"--only={camera}" for camera in given["cameras"].split(",") if camera]
    command += [f"--{name}={given[name]}" for name in ("record", "state") if given[name]]
    for name, flag in FLAGS.items():
        if given[name].lower() not in ("true", "false"):
            raise ConfigError(f"launch argument {name}:={given[name]}: take true or false")
        command += [flag] if given[name].lower() == "true" else []
    # launch waits 5 s between its signals by default; the nodes may take 10 s to finish their work.
    return [ExecuteProcess(cmd=command, output="both", sigterm_timeout="20", sigkill_timeout="5", on_exit=[Shutdown()])]
