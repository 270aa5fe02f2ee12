"""The constants of fusion: read from the file beside a network."""

from __future__ import annotations

from pathlib import Path

import pytest

from ltm_core.base.errors import ConfigError
from ltm_core.depth.fusion_config import FusionConfig, fusion_path, load_fusion_config
from ltm_core.storage.config_io import load_yaml
from ltm_core.vision.manifest import NetworkManifest


def test_an_unknown_constant_in_the_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "net_fusion.yaml").write_text("decision: {opne: 0.2}\n")
    with pytest.raises(ConfigError, match="opne"):
        load_yaml(tmp_path / "net_fusion.yaml", FusionConfig)


def test_the_shipped_network_brings_its_own_and_another_takes_the_defaults(tmp_path: Path) -> None:
    manifest = NetworkManifest.find("landscape_lite0_depth")
    assert fusion_path(manifest).is_file()
    assert load_fusion_config(manifest) == load_yaml(fusion_path(manifest), FusionConfig)
    copy = tmp_path / "other.yaml"
    copy.write_text((manifest.folder / f"{manifest.name}.yaml").read_text().replace(manifest.name, "other", 1))
    assert load_fusion_config(NetworkManifest.load(copy)) == FusionConfig()
