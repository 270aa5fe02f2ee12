"""The constants of fusion: each with its origin and meaning, written and read, and left out stage by stage."""

from __future__ import annotations

from pathlib import Path

import pytest

from ltm_core.base.errors import ConfigError
from ltm_core.depth.fusion_config import FusionConfig, fusion_path, load_fusion_config, write_fusion_config
from ltm_core.storage.config_io import load_yaml
from ltm_core.vision.manifest import NetworkManifest


def test_every_constant_says_what_it_is_and_where_it_comes_from() -> None:
    constants = list(FusionConfig().constants())
    assert len(constants) > 100
    assert len({name for name, *_ in constants}) == len(constants)
    for name, _, origin, meaning in constants:
        assert origin in ("derived", "fitted", "chosen"), name
        assert len(meaning) > 3, name


def test_constants_survive_their_file(tmp_path: Path) -> None:
    config = FusionConfig().updated({"occlusion.standing.tree": 1.25, "error_model.shrink": (2.0, 9.0)})
    write_fusion_config(tmp_path / "net_fusion.yaml", config, "a test")
    text = (tmp_path / "net_fusion.yaml").read_text()
    assert "a test" in text
    assert "# fitted; trees" in text
    assert load_yaml(tmp_path / "net_fusion.yaml", FusionConfig) == config


def test_an_unknown_constant_in_the_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "net_fusion.yaml").write_text("decision: {opne: 0.2}\n")
    with pytest.raises(ConfigError, match="opne"):
        load_yaml(tmp_path / "net_fusion.yaml", FusionConfig)


def test_constants_of_one_network_are_not_written_through_a_link_to_anothers(tmp_path: Path) -> None:
    own, other = tmp_path / "net_fusion.yaml", tmp_path / "longer_fusion.yaml"
    write_fusion_config(own, FusionConfig(), "a test")
    other.symlink_to(own.name)
    write_fusion_config(other, FusionConfig(), "another test")
    assert not other.is_symlink()
    assert "another" not in own.read_text()
    assert "another test" in other.read_text()


def test_the_shipped_network_brings_its_own_and_another_takes_the_defaults(tmp_path: Path) -> None:
    manifest = NetworkManifest.find("landscape_lite0_depth")
    assert fusion_path(manifest).is_file()
    assert load_fusion_config(manifest) == load_yaml(fusion_path(manifest), FusionConfig)
    copy = tmp_path / "other.yaml"
    copy.write_text((manifest.folder / f"{manifest.name}.yaml").read_text().replace(manifest.name, "other", 1))
    assert load_fusion_config(NetworkManifest.load(copy)) == FusionConfig()
