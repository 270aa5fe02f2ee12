"""Find the files of `config/` in a checkout, beside an installed package, or in an ament prefix."""

import os
import sys
from pathlib import Path

from ltm_core.base.errors import ConfigError


def config_path(name: str) -> Path:
    """Return the file `config/<name>` that ships with the project. Raises ConfigError naming the folders searched."""
    return project_path(f"config/{name}")


def project_path(name: str) -> Path:
    """Return a file or folder that ships with the project, such as `bags/demo`. Raises as `config_path` does."""
    prefixes = [prefix for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    roots = [Path(__file__).parents[2], *(Path(prefix) / "share/ltm" for prefix in (sys.prefix, *prefixes))]
    for root in roots:
        if (root / name).exists():
            return root / name
    raise ConfigError(f"{name} of this project not found in {', '.join(map(str, roots))}; install ltm again")
