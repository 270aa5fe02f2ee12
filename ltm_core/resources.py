"""Where the files of `config/` lie: in a checkout, beside an installed package, or in an ament prefix."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from ltm_core.errors import ConfigError


def config_path(name: str) -> Path:
    """The file `config/<name>` that ships with the project. Raises ConfigError naming the folders searched."""
    roots = [Path(__file__).parents[1] / "config", Path(sys.prefix) / "share/ltm/config"]
    roots += [
        Path(prefix) / "share/ltm/config"
        for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
        if prefix
    ]
    for root in roots:
        if (root / name).is_file():
            return root / name
    raise ConfigError(f"config file {name!r} not found in {', '.join(map(str, roots))}; install ltm again")
