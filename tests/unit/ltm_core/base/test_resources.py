import sys
from pathlib import Path

import pytest

from ltm_core.base import resources
from ltm_core.base.errors import ConfigError
from ltm_core.base.resources import config_path, project_path


def test_in_a_checkout() -> None:
    assert config_path("labels.yaml") == Path(resources.__file__).parents[2] / "config/labels.yaml"
    assert project_path("bags/demo").is_dir()


@pytest.mark.parametrize("place", ["prefix", "ament"])
def test_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    monkeypatch.setattr(resources, "__file__", str(tmp_path / "site-packages/ltm_core/base/resources.py"))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "prefix"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'other'}:{tmp_path / 'ament'}")
    shared = tmp_path / place / "share/ltm/config"
    shared.mkdir(parents=True)
    (shared / "labels.yaml").touch()
    assert config_path("labels.yaml") == shared / "labels.yaml"


def test_absent() -> None:
    with pytest.raises(ConfigError, match=r"config/absent\.yaml of this project not found in .*install ltm again"):
        config_path("absent.yaml")
