"""Secrets that systemd has read for a service: files in a folder that it names (systemd.exec(5), LoadCredential=)."""

from __future__ import annotations

import os
from pathlib import Path

FOLDER_VARIABLE = "CREDENTIALS_DIRECTORY"
"""Environment variable with the folder."""
PREFIX = "ltm_"
"""`LoadCredential=ltm:/etc/ltm/credentials` gives each file NAME of that folder as ltm_NAME."""


def service_credential(name: str) -> Path | None:
    """The file of the credential `name`: of that very name, else with the prefix; None where the service has none."""
    folder = os.environ.get(FOLDER_VARIABLE)
    if not folder:
        return None
    files = (Path(folder) / given for given in (name, f"{PREFIX}{name}"))
    return next((file for file in files if file.is_file()), None)


def secret(path: Path) -> Path:
    """Return the service's credential with the name of `path` if it has one, else `path`."""
    return service_credential(path.name) or path
