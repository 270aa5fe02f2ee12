"""Reads and writes the file beside a manifest that says where its pictures lie: `<model>_domain.yaml`."""

from __future__ import annotations

from pathlib import Path

import yaml

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.storage.config_io import load_yaml
from ltm_core.storage.disk_io import is_file
from ltm_core.vision.manifest import DOMAIN_SUFFIX, NetworkManifest
from ltm_core.vision.picture_domain import DomainSpace

_DIGITS = 5


def domain_path(manifest: NetworkManifest) -> Path:
    """Where the domains of a network lie."""
    return manifest.folder / f"{manifest.name}{DOMAIN_SUFFIX}"


def load_domain(manifest: NetworkManifest) -> DomainSpace | None:
    """Of a network; None where nobody measured it. Raises ModelError for a file that cannot be taken, or is of another
    network or of a map that the manifest does not state."""
    path = domain_path(manifest)
    if not is_file(path):
        return None
    try:
        space = load_yaml(path, DomainSpace)
    except ConfigError as reason:
        raise ModelError(str(reason)) from reason
    if space.sha256 != manifest.sha256 or space.map not in manifest.maps:
        raise ModelError(
            f"{path}: is of network {space.network!r} with sha256 {space.sha256} and its map {space.map!r}; "
            f"{manifest.name!r} has {manifest.sha256} and {', '.join(manifest.maps) or 'no maps'}. Measure it again: "
            f"ltm-lab train domains FOLDER... --model {manifest.name}"
        )
    return space


def write_domain(path: Path, space: DomainSpace) -> None:
    """Write it; numbers with five digits."""
    data = space.model_dump(mode="json")
    data["mean"] = _rounded(data["mean"])
    data["axes"] = [_rounded(row) for row in data["axes"]]
    text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=118)
    path.write_text(
        f"# Where pictures lie for a head to be chosen, written by `ltm-lab train domains`: docs/labels.md.\n{text}"
    )


def _rounded(row: list[float]) -> list[float]:
    return [float(f"{value:.{_DIGITS}g}") for value in row]
