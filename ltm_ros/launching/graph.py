"""The node graph of a site as plain data: `ltm run` and `ros2 launch` render the same description. Knows no ROS."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import yaml

from ltm_core.base.errors import ConfigError
from ltm_core.site.sections import WatchdogConfig
from ltm_core.site.site import Site
from ltm_core.surface.surface_versions_io import FOLDER

ParameterValue = bool | int | float | str | list[bool] | list[int] | list[float] | list[str]

PACKAGE = "ltm"
NODES_MODULE = "ltm_ros.nodes"
CAMERAS_MODULE = f"{NODES_MODULE}.cameras"

SOURCE_NODES = ("source",)
"""Node types that a camera has besides where its site file has a section `source` for it, outside a replay."""
CAMERA_NODES = ("capture", "depth", "segmentation", "fuel_votes")
"""Node types that every camera has one of, in `/<site>/<camera>`."""
FUSION_NODES = ("topodepth",)
"""Node types that every camera has besides where the site names a depth network."""
POSE_NODES = ("pose",)
"""Node types that every camera has besides where the site's file has a section `refine_poses`."""
SITE_NODES = ("fuel_map",)
"""Node types that a site has one of, in `/<site>`."""
SURFACE_NODES = ("terrain", "depth", "topodepth")
"""Node types that make or follow the confirmed surface, where the site asks for it."""
TERRAIN_NODES = ("terrain",)
"""Node types that a site has one of where its file has a section `terrain`."""
LOCATING_NODES = ("locate",)
"""Node types that a site has one of where its file has a section `locating`."""
REGION_NODES = ("uplink",)
"""Node types that a site has one of where its file has a section `region`, outside a replay; the graph works without
them."""
OPTIONAL_NODES = ("viewer", "recorder", "health")
"""Site-level node types that run on request; the graph works without them."""
NODE_TYPES = (
    *SOURCE_NODES,
    *CAMERA_NODES,
    *FUSION_NODES,
    *POSE_NODES,
    *SITE_NODES,
    *TERRAIN_NODES,
    *LOCATING_NODES,
    *REGION_NODES,
    *OPTIONAL_NODES,
)

CAMERAS_PROCESS = "cameras"
"""Label of the process in which the nodes of all cameras live, where a site has one for them."""
SOURCES_PROCESS = "sources"
"""Label of the process in which all cameras are asked for their pictures, where a site has one for its cameras: what a
camera sends, and the libraries that read it, shall not touch the work on frames."""
BUSY_NODES = ("depth", "segmentation", "topodepth")
"""Node types that compute on several threads; the others get one."""
OWN_PARAMETERS = ("site", "camera", "use_sim_time", "surfaces")
"""Parameters that the graph itself gives; a site file cannot."""

# What ROS allows for a name and a namespace.
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


@dataclass(frozen=True)
class NodeSpec:
    """One node of the graph."""

    name: str
    namespace: str
    """Absolute, such as `/ridge/north`."""
    module: str
    """Python module that runs the node: `python -m ltm_ros.nodes.depth`."""
    parameters: Mapping[str, ParameterValue] = field(default_factory=dict)
    remappings: Sequence[tuple[str, str]] = ()
    required: bool = True
    """Whether the graph is of use without it."""
    busy: bool = False
    """Whether it computes on several threads."""
    process: str = ""
    """Label of the process that it shares with other nodes; empty: it has one of its own."""

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise ConfigError(f"node name {self.name!r}: use letters, digits and _, starting with a letter")
        if not _NAMESPACE.fullmatch(self.namespace):
            raise ConfigError(f"namespace {self.namespace!r} of node {self.name}: expected the form /site/camera")

    @property
    def executable(self) -> str:
        """Its name in `ros2 run ltm ...`."""
        return self.module.rpartition(".")[2]

    @property
    def full_name(self) -> str:
        """Fully qualified, as ROS and `/diagnostics` name it: `/ridge/north/depth`."""
        return f"{self.namespace}/{self.name}"

    @property
    def label(self) -> str:
        """Short and unique within a site, for logs and `kill`: `north/depth`, `fuel_map`."""
        return "/".join([*self.namespace.split("/")[2:], self.name])


@dataclass(frozen=True)
class ProcessSpec:
    """One process of the graph: a node alone, or several that hand messages to each other (`shared`)."""

    label: str
    nodes: tuple[NodeSpec, ...]

    @property
    def shared(self) -> bool:
        return bool(self.nodes[0].process)

    @property
    def required(self) -> bool:
        """Whether the graph is of use without it."""
        return any(node.required for node in self.nodes)

    @property
    def busy(self) -> bool:
        """Whether numerical libraries may use several threads in it; a shared one has a thread a core for frames."""
        return not self.shared and self.nodes[0].busy


@dataclass(frozen=True)
class Graph:
    """All nodes of a site. Labels are unique."""

    site: str
    nodes: tuple[NodeSpec, ...]
    watchdog: WatchdogConfig = field(default_factory=WatchdogConfig)

    def __post_init__(self) -> None:
        labels = [node.label for node in self.nodes]
        twice = sorted({label for label in labels if labels.count(label) > 1})
        if twice:
            raise ConfigError(f"graph of {self.site}: more than one node {', '.join(twice)}")

    @property
    def processes(self) -> tuple[ProcessSpec, ...]:
        """In the order of their first nodes."""
        members: dict[str, list[NodeSpec]] = {}
        for node in self.nodes:
            members.setdefault(node.process or node.label, []).append(node)
        return tuple(ProcessSpec(label, tuple(nodes)) for label, nodes in members.items())

    def process(self, label: str) -> ProcessSpec:
        """Raises ConfigError naming the processes there are."""
        for process in self.processes:
            if process.label == label:
                return process
        there = ", ".join(process.label for process in self.processes)
        raise ConfigError(f"no process {label!r} in the graph of {self.site}; it has {there}")

    def __iter__(self) -> Iterator[NodeSpec]:
        return iter(self.nodes)

    def __len__(self) -> int:
        return len(self.nodes)

    def node(self, label: str) -> NodeSpec:
        """Raises ConfigError naming the nodes there are."""
        for node in self.nodes:
            if node.label == label:
                return node
        raise ConfigError(f"no node {label!r} in the graph of {self.site}; it has {', '.join(n.label for n in self)}")


def describe(
    site: Site,
    path: Path | str,
    *,
    cameras: Sequence[str] = (),
    sim_time: bool = False,
    view: Mapping[str, ParameterValue] | None = None,
    record: Mapping[str, ParameterValue] | None = None,
    health: Mapping[str, ParameterValue] | None = None,
    parameters: Mapping[str, Mapping[str, ParameterValue]] | None = None,
    sources: bool | None = None,
) -> Graph:
    """The graph of `site`, which was read from `path`.

    `cameras`: only these (empty: all). `view`, `record`: also run the viewer, the recorder, with these parameters;
    `health`: the node that answers monitoring systems, too, where the site's file has a section for it.
    `parameters`: by node type, over those of the site file. Raises ConfigError for an unknown camera or node type, a
    parameter that the graph itself gives, and a value that ROS has no parameter type for.

    `sources`: whether cameras are asked for their pictures; None: unless there is `sim_time`, for a recording brings
    its own.

    With `sim_time` no camera's frames are shed unless a parameter says so: a recording waits, and shall come through
    whole.
    """
    place = Path(path).expanduser().resolve()
    given = _overrides(site, place, parameters or {})
    for extra, values in (("viewer", view), ("recorder", record), ("health", health)):
        given[extra] = given.get(extra, {}) | dict(values or {})
    if sim_time:
        given["capture"] = {"shed": False} | given.get("capture", {})
    if site.terrain is not None and site.terrain.trace_confirmed:
        surfaces = _surfaces_folder(place, given.get("terrain", {}))
        for kind in SURFACE_NODES:
            given[kind] = given.get(kind, {}) | {"surfaces": surfaces}
    together = site.processes == "site"
    common: dict[str, ParameterValue] = {"site": str(place), "use_sim_time": sim_time}

    def spec(kind: str, namespace: str, own: Mapping[str, ParameterValue]) -> NodeSpec:
        return NodeSpec(
            name=kind,
            namespace=namespace,
            module=f"{NODES_MODULE}.{kind}",
            parameters=common | dict(own) | given.get(kind, {}),
            required=kind not in OPTIONAL_NODES + REGION_NODES,
            busy=kind in BUSY_NODES,
            process=process_of(kind),
        )

    def process_of(kind: str) -> str:
        if not together:
            return ""
        if kind in SOURCE_NODES:
            return SOURCES_PROCESS
        return CAMERAS_PROCESS if kind in CAMERA_NODES + FUSION_NODES + POSE_NODES else ""

    chosen = list(cameras) or list(site.cameras)
    for camera in chosen:
        site.camera(camera)
    of_site = SITE_NODES + (TERRAIN_NODES if site.terrain is not None else ())
    of_site += LOCATING_NODES if site.locating is not None else ()
    of_site += REGION_NODES if site.region is not None and not sim_time else ()
    nodes = [spec(kind, f"/{site.name}", {}) for kind in of_site]
    kinds = CAMERA_NODES + (FUSION_NODES if site.depth_model else ())
    kinds += POSE_NODES if site.refine_poses is not None else ()
    nodes += [spec(kind, f"/{site.name}/{camera}", {"camera": camera}) for camera in chosen for kind in kinds]
    if not sim_time if sources is None else sources:
        asked = [camera for camera in chosen if site.camera(camera).source is not None]
        nodes += [spec(kind, f"/{site.name}/{camera}", {"camera": camera}) for camera in asked for kind in SOURCE_NODES]
    if view is not None:
        nodes.append(spec("viewer", f"/{site.name}", {}))
    if record is not None:
        nodes.append(spec("recorder", f"/{site.name}", {}))
    if health is not None and site.health is not None:
        expected = [node.full_name for node in nodes]
        nodes.append(spec("health", f"/{site.name}", {"expected": expected}))
    return Graph(site.name, tuple(nodes), site.watchdog)


def _surfaces_folder(site: Path, terrain: Mapping[str, ParameterValue]) -> str:
    """Where the confirmed surfaces are kept: beside the terrain's store. Raises ConfigError where it has no place."""
    folder = str(terrain.get("folder", ""))
    if not folder:
        raise ConfigError(
            f"{site}: terrain.trace_confirmed needs a place for the confirmed surfaces: give the terrain a folder "
            "(`nodes: {terrain: {folder: kept}}`), or the command a --state"
        )
    return str(site.parent / Path(folder).expanduser() / FOLDER)


def parameters_yaml(parameters: Mapping[str, ParameterValue]) -> str:
    """A ROS parameters file for one node of any name. Strings are quoted: bare `y` or `on` would become booleans."""
    lines = ["/**:", "  ros__parameters:"]
    for name, value in parameters.items():
        lines.append(f"    {name}: {_scalar_or_list(value)}")
    return "\n".join(lines) + "\n"


def nodes_json(nodes: Sequence[NodeSpec]) -> str:
    """What a process that several nodes share is told of them; `nodes_of_json` reads it."""
    return json.dumps([asdict(node) for node in nodes], indent=1)


def nodes_of_json(text: str) -> tuple[NodeSpec, ...]:
    return tuple(
        NodeSpec(**given | {"remappings": tuple((old, new) for old, new in given["remappings"])})
        for given in json.loads(text)
    )


def _scalar_or_list(value: ParameterValue) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_scalar(item) for item in value)}]"
    return _scalar(value)


def _scalar(value: bool | int | float | str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    text: str = yaml.safe_dump(value, default_style='"' if isinstance(value, str) else None, width=1 << 30)
    return text.removesuffix("\n").removesuffix("\n...")


def _overrides(
    site: Site, place: Path, parameters: Mapping[str, Mapping[str, ParameterValue]]
) -> dict[str, dict[str, ParameterValue]]:
    merged: dict[str, dict[str, ParameterValue]] = {}
    for where, source in ((f"{place}: nodes", site.nodes), ("parameters", parameters)):
        for kind, values in source.items():
            if kind not in NODE_TYPES:
                raise ConfigError(f"{where}: unknown node {kind!r}; known are {', '.join(NODE_TYPES)}")
            for name, value in _flat(values).items():
                if name in OWN_PARAMETERS:
                    raise ConfigError(f"{where}.{kind}.{name}: the graph gives this parameter itself; remove it")
                merged.setdefault(kind, {})[name] = _ros_value(value, f"{where}.{kind}.{name}")
    return merged


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings as ROS has them: `{a: {b: 1}}` is parameter `a.b`."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def _ros_value(value: object, place: str) -> ParameterValue:
    """Raises ConfigError: ROS knows booleans, integers, floats, strings and non-empty lists of one of them."""
    if isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, list | tuple) and value:
        items = list(value)
        if all(isinstance(item, bool) for item in items) or all(isinstance(item, str) for item in items):
            return items
        if all(isinstance(item, int | float) and not isinstance(item, bool) for item in items):
            return items if all(isinstance(item, int) for item in items) else [float(item) for item in items]
    raise ConfigError(
        f"{place} = {value!r}: a parameter is a boolean, integer, float, string or non-empty list of one of these"
    )
