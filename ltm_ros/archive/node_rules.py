"""The parameters of the nodes whose work an archive does, as a site file sets them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ltm_core.config_io import checked
from ltm_core.frame_steps import LabellingConfig, TracingConfig
from ltm_core.site import Site
from ltm_ros.archive.manifest import ManifestRules
from ltm_ros.launching.graph import describe
from ltm_ros.runtime.frame_join import FrameJoinConfig


def node_rules(site: Site, path: Path, camera: str) -> tuple[ManifestRules, TracingConfig, LabellingConfig]:
    """Defaults are those of the nodes. Raises ConfigError."""
    from ltm_ros.nodes.fuel_map import FuelMapConfig

    graph = describe(site, path)

    def given(label: str) -> dict[str, Any]:
        return {k: v for k, v in graph.node(label).parameters.items() if k != "use_sim_time"}

    def only(model: type[Any], label: str) -> Any:
        values = {name: value for name, value in given(label).items() if name in model.model_fields}
        return checked(model, values, f"parameters of {label}")

    fuel_map = checked(FuelMapConfig, given("fuel_map"), "parameters of fuel_map")
    join = only(FrameJoinConfig, f"{camera}/capture")
    rules = ManifestRules(join, fuel_map.max_ahead, fuel_map.max_behind)
    return rules, only(TracingConfig, f"{camera}/depth"), only(LabellingConfig, f"{camera}/segmentation")
