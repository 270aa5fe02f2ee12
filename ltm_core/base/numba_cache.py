"""Give numba's cache of compiled kernels one folder per state of the source, so that no stale code is loaded.

Numba checks only the file of the kernel that it loads. When a kernel *called* by it, or a constant frozen into it, in
another file, has changed, the old machine code would be loaded and give wrong results silently. So the state is that of
all files that kernels may depend on: those that name numba or `base.kernels`, and what these import of the same
package, at any depth. An edit elsewhere recompiles nothing.

A release carries folders compiled for two levels of x86-64, made by `packaging/precompile.py` and named by the state,
the versions of Python and numba, and the level. The best that the processor can run is copied to where the cache is."""

import contextlib
import hashlib
import os
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Final

_V2 = frozenset(("cx16", "lahf_lm", "popcnt", "sse4_1", "sse4_2", "ssse3"))
_V3 = _V2 | frozenset(("abm", "avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "movbe", "xsave"))
CPU_LEVELS: Final = {"x86-64-v3": _V3, "x86-64-v2": _V2}
"""Levels of x86-64 that releases have kernels for, the fastest first, with the flags in /proc/cpuinfo that each needs
(x86-64 psABI, table 3.1)."""
PRECOMPILED: Final = "precompiled"
_VARIABLE = "NUMBA_CACHE_DIR"
_PREFIX = "ltm-kernels-"
_KEPT = 3
"""Number of folders of earlier source states to keep, for processes that still run them."""
_IMPORT = re.compile(rb"^\s*(?:import\s+([\w.]+)|from\s+([\w.]+)\s+import\s+(\([^)]*\)|[^\n]*))", re.MULTILINE)
_NAME = re.compile(rb"\w+")


def use_own_cache(source: Path) -> Path | None:
    """Point numba to the cache of this state of `source`. Return the folder, or None if it is not our own.

    Numba reads the variable when it is imported; if it was imported before, as by pytest, its setting is changed too.
    A NUMBA_CACHE_DIR that the user has set is kept; without a writable place nothing changes. Cached code is executed,
    so a folder outside the source must belong to us."""
    given = os.environ.get(_VARIABLE)
    if given and not Path(given).name.startswith(_PREFIX):
        return None
    state = _state(source)
    level = _precompiled_level(source, state)
    beside = source / "__pycache__"
    for parent in (beside, Path.home() / ".cache/ltm", Path(tempfile.gettempdir()) / f"ltm-{os.getuid()}"):
        folder = parent / f"{_PREFIX}{state}{level and '-'}{level}"
        try:
            if not _usable(parent, parent == beside):
                continue
            if level and not folder.exists():
                _copy(source / PRECOMPILED / precompiled_name(state, level), folder)
            if not _usable(folder, parent == beside) or not os.access(folder, os.W_OK):
                continue
        except OSError:
            continue
        os.environ[_VARIABLE] = str(folder)
        if "numba" in sys.modules:
            sys.modules["numba"].config.CACHE_DIR = str(folder)
        _forget_former(parent, folder)
        return folder
    return None


def kernel_level(folder: Path) -> str:
    """Return the level of x86-64 that the kernels in a cache folder are compiled for; empty: this processor."""
    return next((level for level in CPU_LEVELS if folder.name.endswith(f"-{level}")), "")


def levels_of(flags: frozenset[str]) -> list[str]:
    """Return those of CPU_LEVELS that a processor with these flags can run, the fastest first."""
    return [level for level, needed in CPU_LEVELS.items() if needed <= flags]


def precompiled_name(state: str, level: str) -> str:
    """Return the name of a release's folder of kernels that the running Python and numba can load."""
    return f"{state}-{sys.implementation.cache_tag}-numba-{version('numba')}-{level}"


def _precompiled_level(source: Path, state: str) -> str:
    """Return the level of the release's kernels to use, empty if it has none for this source and this processor."""
    if not (source / PRECOMPILED).is_dir() or "NUMBA_CPU_NAME" in os.environ:
        return ""
    usable = (x for x in levels_of(cpu_flags()) if (source / PRECOMPILED / precompiled_name(state, x)).is_dir())
    return next(usable, "")


def cpu_flags() -> frozenset[str]:
    """Return the processor's features by their names in /proc/cpuinfo; none where there is no such file."""
    with contextlib.suppress(OSError), Path("/proc/cpuinfo").open(encoding="ascii", errors="replace") as lines:
        for line in lines:
            if line.startswith("flags"):
                return frozenset(line.partition(":")[2].split())
    return frozenset()


def _copy(precompiled: Path, folder: Path) -> None:
    """Copy a release's kernels in one step, because other processes start at the same time."""
    partial = Path(tempfile.mkdtemp(prefix=f"{folder.name}.", dir=folder.parent))
    try:
        shutil.copytree(precompiled, partial, dirs_exist_ok=True, copy_function=shutil.copyfile)
        partial.chmod(0o700)  # not the release's mode
        partial.rename(folder)
    except OSError:
        shutil.rmtree(partial, ignore_errors=True)
        if not folder.exists():
            raise


def _state(source: Path) -> str:
    modules = {_module_name(file, source): file.read_bytes() for file in source.rglob("*.py")}
    needed: set[bytes] = set()
    ahead = [name for name, text in modules.items() if b"numba" in text or b"base.kernels" in text]
    while ahead:
        name = ahead.pop()
        if name not in needed:
            needed.add(name)
            ahead += [found for found in _imports(modules[name]) if found in modules]
    digest = hashlib.sha256()
    for name in sorted(needed):
        digest.update(name)
        digest.update(modules[name])
    return digest.hexdigest()[:16]


def _module_name(file: Path, source: Path) -> bytes:
    parts = file.relative_to(source.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts).encode()


def _imports(text: bytes) -> Iterator[bytes]:
    """Return all names that a module may import; a name within a package may be a module or not."""
    for direct, package, names in _IMPORT.findall(text):
        yield direct or package
        for name in _NAME.findall(names):
            yield package + b"." + name


def _usable(folder: Path, in_source: bool) -> bool:
    """Create a missing folder; return whether it is in the source, or ours and inaccessible to other users. A link is
    not accepted, because its target may change."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(mode=0o777 if in_source else 0o700, exist_ok=True)
    found = folder.lstat()
    return in_source or (stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077)


def _forget_former(parent: Path, current: Path) -> None:
    with contextlib.suppress(FileNotFoundError):  # another process, which starts just now too, deletes them
        former = sorted((f for f in parent.glob(f"{_PREFIX}*") if f != current), key=lambda f: f.stat().st_mtime)
        for folder in former[:-_KEPT]:
            shutil.rmtree(folder, ignore_errors=True)
