"""Options that commands of the laboratory share."""

from pathlib import Path
from typing import Annotated

from typer import Option

from ltm_core.storage.disk_io import require_files, require_folder


def writable_file(path: Path | None) -> Path | None:
    """Check an option that names a file, which may exist. Raises ConfigError."""
    require_files([] if path is None else [path])
    return path


def writable_folder(path: Path | None) -> Path | None:
    """Check an option that names a folder. Raises ConfigError."""
    if path is not None:
        require_folder(path)
    return path


JsonFile = Annotated[Path | None, Option("--json", help="Also write all figures to this file.", callback=writable_file)]
