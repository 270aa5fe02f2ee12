"""Where numba keeps compiled kernels: a folder of its own for each state of the source.

Numba looks only at the file of the kernel that it loads. When a kernel *called* by it, in another file, has changed,
the old machine code would be taken and its answers would be wrong without a word.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import tempfile
from pathlib import Path

_VARIABLE = "NUMBA_CACHE_DIR"
_PREFIX = "ltm-kernels-"
_KEPT = 3
"""Folders of former states of the source that stay, for processes that still run them."""


def use_own_cache(source: Path) -> Path | None:
    """Point numba to the cache of this state of `source`; the folder, or None where not ours.

    Numba reads the variable when it is imported: where somebody has imported it before us, as pytest does, it is told.
    A NUMBA_CACHE_DIR that the user has set is left alone; so is everything where no place can be written to.
    """
    given = os.environ.get(_VARIABLE)
    if given and not Path(given).name.startswith(_PREFIX):
        return None
    digest = hashlib.sha256()
    for file in sorted(source.rglob("*.py")):
        digest.update(file.relative_to(source).as_posix().encode())
        digest.update(file.read_bytes())
    for parent in (
        source / "__pycache__",
        Path.home() / ".cache/ltm",
        Path(tempfile.gettempdir()) / f"ltm-{os.getuid()}",
    ):
        folder = parent / f"{_PREFIX}{digest.hexdigest()[:16]}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            os.environ[_VARIABLE] = str(folder)
            if "numba" in sys.modules:
                sys.modules["numba"].config.CACHE_DIR = str(folder)
            _forget_former(parent, folder)
            return folder
    return None


def _forget_former(parent: Path, current: Path) -> None:
    former = sorted((f for f in parent.glob(f"{_PREFIX}*") if f != current), key=_age)
    for folder in former[:-_KEPT]:
        shutil.rmtree(folder, ignore_errors=True)


def _age(folder: Path) -> float:
    """Time of the last change; 0 where another process, which starts just now too, has deleted the folder."""
    try:
        return folder.stat().st_mtime
    except FileNotFoundError:
        return 0.0
