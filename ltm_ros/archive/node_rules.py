"""Read the parameters of the nodes whose work an archive does, from the site file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ltm_core.base.errors import ArchiveError
from ltm_core.pipeline.frame_steps import LabellingConfig, TracingConfig
from ltm_core.pipeline.fusing_step import FusingConfig
from ltm_core.site.site import Site
from ltm_core.storage.config_io import checked
from ltm_ros.archive.manifest import ManifestRules
from ltm_ros.launching.graph import describe
from ltm_ros.runtime.frame_join import FrameJoinConfig


@dataclass(frozen=True)
class NodeRules:
    """Parameters of a site's nodes for joining, tracing and labelling; `fusing`: None without a depth network."""

    manifest: ManifestRules
    tracing: TracingConfig
    labelling: LabellingConfig
    fusing: FusingConfig | None


def node_rules(site: Site, path: Path, camera: str) -> NodeRules:
    """Return the parameters, with the nodes' defaults. Raises ConfigError."""
    from ltm_ros.fuel_map.config import FuelMapConfig

    graph = describe(site, path)

    def given(label: str) -> dict[str, Any]:
        return {k: v for k, v in graph.node(label).parameters.items() if k != "use_sim_time"}

    def only(model: type[Any], label: str) -> Any:
        values = {name: value for name, value in given(label).items() if name in model.model_fields}
        return checked(model, values, f"parameters of {label}")

    fuel_map = checked(FuelMapConfig, given("fuel_map"), "parameters of fuel_map")
    join = only(FrameJoinConfig, f"{camera}/capture")
    rules = ManifestRules(join, fuel_map.max_ahead, fuel_map.max_behind)
    fusing = only(FusingConfig, f"{camera}/topodepth") if site.depth_model else None
    return NodeRules(
        rules, only(TracingConfig, f"{camera}/depth"), only(LabellingConfig, f"{camera}/segmentation"), fusing
    )


def refuse_terrain(site: Site) -> None:
    """Raise ArchiveError with the remedy for a site whose terrain cannot be reprocessed."""
    if site.terrain is None:
        raise ArchiveError(f"site {site.name} has no section `terrain`: add one, or run without --terrain")
    if not site.depth_model or site.nodes.get("terrain", {}).get("depth_from_elsewhere"):
        raise ArchiveError(
            f"site {site.name}: the terrain of an archive needs depth from a network: set `depth_model` to a "
            "depth network, without depth_from_elsewhere, or run without --terrain"
        )
    if site.terrain.trace_confirmed:
        raise ArchiveError(
            f"site {site.name} traces depth to the confirmed surface (terrain.trace_confirmed): a frame's votes "
            "then depend on earlier frames. Remove the setting for the archive, or run without --terrain"
        )
