"""The constants of fusion beside a depth network's manifest: `<network>_fusion.yaml`."""

from __future__ import annotations

import json
from itertools import groupby
from pathlib import Path

from ltm_core.config_io import load_yaml
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.vision.manifest import FUSION_SUFFIX, Manifest


def fusion_path(manifest: Manifest) -> Path:
    """Where the constants that were fitted with a network lie."""
    return manifest.folder / f"{manifest.name}{FUSION_SUFFIX}"


def load_fusion_config(manifest: Manifest) -> FusionConfig:
    """The constants beside a manifest; the defaults where there are none. Raises ConfigError for a wrong file."""
    path = fusion_path(manifest)
    return load_yaml(path, FusionConfig) if path.is_file() else FusionConfig()


def write_fusion_config(path: Path, config: FusionConfig, source: str) -> None:
    """Write every constant, each with its origin and meaning. `source`: how the fitted ones were found, in words."""
    lines = [f"# Constants of depth fusion (ltm_core/depth/fusion_config.py). Fitted ones by: {source}"]
    before: list[str] = []
    for group, constants in groupby(config.constants(), key=lambda c: c[0].rpartition(".")[0]):
        parts = group.split(".")
        shared = sum(1 for a, b in zip(before, parts, strict=False) if a == b)
        lines += [f"{'  ' * depth}{parts[depth]}:" for depth in range(shared, len(parts))]
        before = parts
        for name, value, origin, meaning in constants:
            text = f"{'  ' * len(parts)}{name.rpartition('.')[2]}: {json.dumps(value)}"
            lines.append(f"{text:<28} # {origin}; {meaning}")
    if path.is_symlink():  # to another network's: that one keeps its own
        path.unlink()
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
