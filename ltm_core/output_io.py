"""Checks, before any work is done, that results can be written where the user wants them, and over nothing else."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from ltm_core.disk_io import folder_that_exists, is_folder, is_there
from ltm_core.errors import ConfigError


def require_folder(folder: Path, what: str = "results") -> None:
    """Raises ConfigError unless files can be written into `folder`, which may be yet to be made; makes nothing."""
    reason = _why_not_into(folder)
    if reason is not None:
        raise ConfigError(f"{folder}: {what} cannot be written there ({reason}): name another folder")


def require_files(files: Iterable[Path], overwrite: bool = True, what: str = "results") -> None:
    """Raises ConfigError unless each of `files` can be written, its folders made where they are missing.

    `overwrite`: whether files may be there already. Makes and changes nothing.
    """
    for file in files:
        if is_folder(file):
            raise ConfigError(f"{file}: is a folder, {what} need the name of a file")
        if is_there(file) and not overwrite:
            raise ConfigError(f"{file}: exists already; name another place, or write over it with --overwrite")
        reason = _why_not_over(file) if is_there(file) else _why_not_into(file.parent) or _why_no_name(file)
        if reason is not None:
            raise ConfigError(f"{file}: {what} cannot be written there ({reason}): name another place")


def _why_not_into(folder: Path) -> str | None:
    """Tried, not asked: permission bits say nothing to root, and of a file system that is read-only."""
    there = folder_that_exists(folder.expanduser())
    if not is_folder(there):
        return f"{there} is no folder"
    try:
        with tempfile.TemporaryFile(dir=there):
            return _why_no_name(folder)
    except OSError as error:
        return error.strerror or str(error)


def _why_no_name(place: Path) -> str | None:
    try:
        place.exists()  # raises for a name that is too long
    except OSError as error:
        return error.strerror or str(error)
    return None


def _why_not_over(file: Path) -> str | None:
    try:
        os.close(os.open(file, os.O_WRONLY))
    except OSError as error:
        return error.strerror or str(error)
    return None
