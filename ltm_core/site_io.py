"""Reads site files (`config/sites/*.yaml`)."""

from __future__ import annotations

from pathlib import Path

from ltm_core.config_io import load_yaml
from ltm_core.site import DemConfig, Site


def load_site(path: Path | str) -> Site:
    """Read a site YAML; its relative paths become relative to the file. Raises ConfigError, see `config_io`."""
    path = Path(path).expanduser().resolve()
    site = load_yaml(path, Site)

    def beside_the_file(dem: DemConfig) -> DemConfig:
        return dem.model_copy(update={"path": path.parent / dem.path})

    changes: dict[str, object] = {
        "dem": beside_the_file(site.dem),
        "coarser": tuple(beside_the_file(dem) for dem in site.coarser),
        "surface": None if site.surface is None else beside_the_file(site.surface),
    }
    for name in ("model", "depth_model"):
        beside = path.parent / getattr(site, name)
        if beside.suffix == ".yaml" and beside.is_file():
            changes[name] = str(beside)
    if site.health is not None:
        given = {name: getattr(site.health, name) for name in ("certificate", "key", "token")}
        files = {name: path.parent / file for name, file in given.items() if file is not None}
        changes["health"] = site.health.model_copy(update=files)
    fuel: dict[str, object] = {}
    if site.fuel.prior is not None:
        fuel["prior"] = site.fuel.prior.below(path.parent)
    if site.fuel.label_errors is not None:
        fuel["label_errors"] = str(path.parent / site.fuel.label_errors)
    if fuel:
        changes["fuel"] = site.fuel.model_copy(update=fuel)
    return site.model_copy(update=changes)
