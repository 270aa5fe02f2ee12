"""Options that name a place for results: whether it can be written is known before the work, not after it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_core.output_io import require_files, require_folder

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Write over files that are there already.")]


def writable_file(path: Path | None) -> Path | None:
    """Callback of an option that names a file, which may be there already. Raises ConfigError."""
    if path is not None:
        require_files([path])
    return path


def writable_folder(path: Path | None) -> Path | None:
    """Callback of an option that names a folder. Raises ConfigError."""
    if path is not None:
        require_folder(path)
    return path


JsonFile = Annotated[
    Path | None, typer.Option("--json", help="Also write every figure to this file.", callback=writable_file)
]
