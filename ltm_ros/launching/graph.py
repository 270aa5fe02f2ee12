"""Describe the node graph of a site as plain data, which `ltm run` and `ros2 launch` both use. Imports no ROS."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypedDict, TypeVar, Unpack

from pydantic import Field, TypeAdapter, ValidationError

from ltm_core.base.errors import ConfigError
from ltm_core.site.sections import WatchdogConfig
from ltm_core.site.site import Site
from ltm_core.surface.surface_versions_io import FOLDER

ParameterValue = bool | int | float | str | list[bool] | list[int] | list[float] | list[str]
_Item = TypeVar("_Item")
_Items = Annotated[list[_Item], Field(min_length=1)]
_PARAMETER: TypeAdapter[ParameterValue] = TypeAdapter(
    bool | int | float | str | _Items[bool] | _Items[int] | _Items[float] | _Items[str]
)

NODES_MODULE = "ltm_ros.nodes"
CAMERAS_MODULE = "ltm_ros.launching.site_process"

CAMERA_NODES = ("capture", "depth", "segmentation", "fuel_votes")
"""Node types that every camera has, in `/<site>/<camera>`; others depend on the sections of the site file."""
FUSION_NODES = ("topodepth",)
"""Additional node types of every camera if the site has a depth network."""
SURFACE_NODES = ("terrain", "depth", "topodepth")
"""Node types that make or follow the confirmed surface, if the site uses it."""
OPTIONAL_NODES = ("uplink", "viewer", "recorder", "health")
"""Node types without which the graph works."""
NODE_TYPES = ("source", *CAMERA_NODES, *FUSION_NODES, "pose", "fuel_map", "terrain", "locate", *OPTIONAL_NODES)

CAMERAS_PROCESS = "cameras"
"""Label of the process that runs the nodes of all cameras, if the site has one."""
SOURCES_PROCESS = "sources"
"""Label of the process that receives the images of all cameras, if the site has one. It is separate, so that what a
camera sends, and the libraries that read it, cannot affect the processing of frames."""
BUSY_NODES = ("depth", "segmentation", "topodepth")
"""Node types that compute on several threads; others get one thread."""
OWN_PARAMETERS = ("site", "camera", "use_sim_time", "surfaces")
"""Parameters that the graph sets; a site file cannot set them."""


@dataclass(frozen=True)
class NodeSpec:
    """One node of the graph."""

    name: str
    namespace: str
    """Absolute namespace, such as `/ridge/north`."""
    module: str
    """Python module that runs the node: `python -m ltm_ros.nodes.depth`."""
    parameters: Mapping[str, ParameterValue] = field(default_factory=dict)
    required: bool = True
    """Whether the graph is useless without it."""
    busy: bool = False
    """Whether it computes on several threads."""
    process: str = ""
    """Label of the process that it shares with other nodes; empty: a process of its own."""

    @property
    def executable(self) -> str:
        """Return its name in `ros2 run ltm ...`."""
        return self.module.rpartition(".")[2]

    @property
    def full_name(self) -> str:
        """Return the full name that ROS and `/diagnostics` use: `/ridge/north/depth`."""
        return f"{self.namespace}/{self.name}"

    @property
    def label(self) -> str:
        """Return the short name for logs and `kill`, unique in a site: `north/depth`, `fuel_map`."""
        return "/".join([*self.namespace.split("/")[2:], self.name])


@dataclass(frozen=True)
class ProcessSpec:
    """One process of the graph: a single node, or several that pass messages directly (`shared`)."""

    label: str
    nodes: tuple[NodeSpec, ...]

    @property
    def shared(self) -> bool:
        return bool(self.nodes[0].process)

    @property
    def required(self) -> bool:
        """Return whether the graph is useless without it."""
        return any(node.required for node in self.nodes)

    @property
    def busy(self) -> bool:
        """Return whether numerical libraries may use several threads; a shared process has one thread per core for
        frames."""
        return not self.shared and self.nodes[0].busy


@dataclass(frozen=True)
class Graph:
    """All nodes of a site. Labels are unique, because no camera has the name of a node (`site.SITE_NAMES`)."""

    site: str
    nodes: tuple[NodeSpec, ...]
    watchdog: WatchdogConfig = field(default_factory=WatchdogConfig)

    @property
    def processes(self) -> tuple[ProcessSpec, ...]:
        """Return the processes in the order of their first nodes."""
        members: dict[str, list[NodeSpec]] = {}
        for node in self.nodes:
            members.setdefault(node.process or node.label, []).append(node)
        return tuple(ProcessSpec(label, tuple(nodes)) for label, nodes in members.items())

    def __iter__(self) -> Iterator[NodeSpec]:
        return iter(self.nodes)

    def __len__(self) -> int:
        return len(self.nodes)

    def node(self, label: str) -> NodeSpec:
        """Return a node by label. Raises ConfigError that lists the nodes."""
        for node in self.nodes:
            if node.label == label:
                return node
        there = ", ".join(node.label for node in self.nodes)
        raise ConfigError(f"no node {label!r} in the graph of {self.site}; it has {there}")


class Wanted(TypedDict, total=False):
    """What to run of a site. `cameras`: only these (empty: all). `view`, `record`, `health` (if the site has that
    section): also run this node, with these parameters. `parameters`: by node type, override those of the site file."""

    cameras: Sequence[str]
    view: Mapping[str, ParameterValue] | None
    record: Mapping[str, ParameterValue] | None
    health: Mapping[str, ParameterValue] | None
    parameters: Mapping[str, Mapping[str, ParameterValue]]


def describe(
    site: Site, path: Path | str, *, sim_time: bool = False, sources: bool | None = None, **wanted: Unpack[Wanted]
) -> Graph:
    """Return the graph of `site`, which was read from `path`.

    `sources`: whether images are requested from cameras; None: unless `sim_time`. With `sim_time` no frames are shed
    unless a parameter enables it. Raises ConfigError for an unknown camera or node type, a parameter that the graph
    sets itself, and a value without a ROS type."""
    place = Path(path).expanduser().resolve()
    given = _overrides(site, place, wanted.get("parameters", {}))
    extras = {"viewer": wanted.get("view"), "recorder": wanted.get("record"), "health": wanted.get("health")}
    for extra, values in extras.items():
        given[extra] = given.get(extra, {}) | dict(values or {})
    if sim_time:
        given["capture"] = {"shed": False} | given.get("capture", {})
    if site.terrain is not None and site.terrain.trace_confirmed:
        if not (folder := str(given.get("terrain", {}).get("folder", ""))):
            raise ConfigError(
                f"{place}: terrain.trace_confirmed needs a folder for the confirmed surfaces: set one for the terrain "
                f"(`nodes: {{terrain: {{folder: kept}}}}`), or pass --state"
            )
        surfaces = str(place.parent / Path(folder).expanduser() / FOLDER)  # beside the terrain's store
        for kind in SURFACE_NODES:
            given[kind] = given.get(kind, {}) | {"surfaces": surfaces}
    shared: dict[str, str] = {}
    if site.processes == "site":
        shared = dict.fromkeys((*CAMERA_NODES, *FUSION_NODES, "pose"), CAMERAS_PROCESS) | {"source": SOURCES_PROCESS}
    common: dict[str, ParameterValue] = {"site": str(place), "use_sim_time": sim_time}

    def spec(kind: str, namespace: str, own: Mapping[str, ParameterValue]) -> NodeSpec:
        return NodeSpec(
            name=kind,
            namespace=namespace,
            module=f"{NODES_MODULE}.{kind}",
            parameters=common | dict(own) | given.get(kind, {}),
            required=kind not in OPTIONAL_NODES,
            busy=kind in BUSY_NODES,
            process=shared.get(kind, ""),
        )

    chosen = list(dict.fromkeys(wanted.get("cameras", ()))) or list(site.cameras)
    for camera in chosen:
        site.camera(camera)
    sections = {"terrain": site.terrain, "locate": site.locating, "uplink": None if sim_time else site.region}
    of_site = ["fuel_map", *(kind for kind, section in sections.items() if section is not None)]
    nodes = [spec(kind, f"/{site.name}", {}) for kind in of_site]
    kinds = CAMERA_NODES + (FUSION_NODES if site.depth_model else ())
    kinds += ("pose",) if site.refine_poses is not None else ()
    nodes += [spec(kind, f"/{site.name}/{camera}", {"camera": camera}) for camera in chosen for kind in kinds]
    if not sim_time if sources is None else sources:
        asked = [camera for camera in chosen if site.camera(camera).source is not None]
        nodes += [spec("source", f"/{site.name}/{camera}", {"camera": camera}) for camera in asked]
    for extra, values in extras.items():
        if values is not None and (extra != "health" or site.health is not None):
            expected = {"expected": [node.full_name for node in nodes]} if extra == "health" else {}
            nodes.append(spec(extra, f"/{site.name}", expected))
    return Graph(site.name, tuple(nodes), site.watchdog)


def parameters_yaml(parameters: Mapping[str, ParameterValue]) -> str:
    """Return a ROS parameters file for a node of any name. Values are JSON, which quotes strings: bare `y` and `on`
    would become booleans."""
    lines = [f"    {name}: {json.dumps(value, ensure_ascii=False)}\n" for name, value in parameters.items()]
    return f"/**:\n  ros__parameters:\n{''.join(lines)}"


def nodes_json(nodes: Sequence[NodeSpec]) -> str:
    """Return the description of the nodes in a shared process, for `nodes_of_json`."""
    return json.dumps([asdict(node) for node in nodes], indent=1)


def nodes_of_json(text: str) -> tuple[NodeSpec, ...]:
    return tuple(NodeSpec(**given) for given in json.loads(text))


def _overrides(
    site: Site, place: Path, parameters: Mapping[str, Mapping[str, ParameterValue]]
) -> dict[str, dict[str, ParameterValue]]:
    merged: dict[str, dict[str, ParameterValue]] = {}
    for where, source in ((f"{place}: nodes", site.nodes), ("parameters", parameters)):
        for kind, values in source.items():
            if kind not in NODE_TYPES:
                raise ConfigError(f"{where}: unknown node {kind!r}; known nodes: {', '.join(NODE_TYPES)}")
            for name, value in _flat(values).items():
                if name in OWN_PARAMETERS:
                    raise ConfigError(f"{where}.{kind}.{name}: the graph sets this parameter itself; remove it")
                try:
                    merged.setdefault(kind, {})[name] = _PARAMETER.validate_python(value, strict=True)
                except ValidationError:
                    raise ConfigError(
                        f"{where}.{kind}.{name} = {value!r}: a parameter is a boolean, integer, float, string or "
                        "non-empty list of one of these"
                    ) from None
    return merged


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Flatten nested mappings as ROS does: `{a: {b: 1}}` is parameter `a.b`."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = value
    return flat
