"""Return the command that starts a process of the graph."""

from __future__ import annotations

from pathlib import Path

from ltm_ros.launching.graph import CAMERAS_MODULE, ProcessSpec, nodes_json, parameters_yaml
from ltm_ros.launching.supervised import supervised_command

_QUIET = ("--disable-external-lib-logs",)
"""We keep a node's output; ROS's own log files in ~/.ros would grow without limit."""


def process_command(spec: ProcessSpec, folder: Path) -> list[str]:
    """Return the command of a supervised process, and write the description of its nodes into `folder`."""
    file = folder / spec.label.replace("/", ".")
    if spec.shared:
        nodes = file.with_name(f"{file.name}.json")
        nodes.write_text(nodes_json(spec.nodes), encoding="utf-8")
        return supervised_command(CAMERAS_MODULE, str(nodes), "--ros-args", *_QUIET)
    node = spec.nodes[0]
    parameters = file.with_name(f"{file.name}.yaml")
    parameters.write_text(parameters_yaml(node.parameters), encoding="utf-8")
    remappings = [("__ns", node.namespace), ("__node", node.name), *node.remappings]
    command = supervised_command(node.module, "--ros-args")
    command += [part for old, new in remappings for part in ("-r", f"{old}:={new}")]
    return [*command, "--params-file", str(parameters), *_QUIET]
