"""Reads region.yaml."""

from __future__ import annotations

from pathlib import Path

from ltm_core.config_io import load_yaml
from ltm_core.uplink.config import BrokerConfig, RegionConfig


def load_region(path: Path | str) -> RegionConfig:
    """Its relative paths become relative to the file. Raises ConfigError, see `config_io`."""
    path = Path(path).expanduser().resolve()
    region = load_yaml(path, RegionConfig)
    changes: dict[str, object] = {
        "site": path.parent / region.site,
        "folder": path.parent / region.folder,
        "broker": broker_beside(region.broker, path.parent),
    }
    if region.export is not None:
        changes["export"] = region.export.model_copy(update={"folder": path.parent / region.export.folder})
    return region.model_copy(update=changes)


def broker_beside(broker: BrokerConfig, folder: Path) -> BrokerConfig:
    """With the paths of its certificates below a folder."""
    return broker.model_copy(update={name: folder / getattr(broker, name) for name in ("ca", "certificate", "key")})
