"""Decoded heights of a large raster in a file beside it that all processes of a site map into memory.

A raster of 10,000 x 10,000 cells takes 400 MB in each process that opens it, and seconds to decode. Its prepared file
`<raster>.ltm-heights` holds the decoded heights; who maps it shares their pages with all others, and reads none that it
does not look at. It is made by `write_heights`, in one step, and belongs to exactly one state of the raster: the files
of which that consists, each with its inode, size and times. `ctime`, which no program can set, is among these: a file
that was written to, replaced or restored, whatever its date, has another. A prepared file that belongs to any other
state, or was written by another version, counts as absent; and so does one of an owner who is neither this process's,
nor the raster's, nor root: otherwise, users with access to the folder could replace the heights of a raster that they
may not write. Its read permissions are those of the raster."""

from __future__ import annotations

import contextlib
import glob
import json
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.types import Float32Array
from ltm_core.storage.disk_io import free_bytes

VERSION = 2
"""Version of the preparation; increase it when the same raster gives other heights."""
LEAST_CELLS = 16 << 20
"""Minimum number of cells of a raster for a prepared file (64 MB); a smaller one is decoded in half a second."""
SPARE_BYTES = 1 << 30
"""Minimum free space on the disk in bytes."""
_HEADER_BYTES = 1 << 16
_SUFFIX = ".ltm-heights"
_MARK = b'{"ltm heights":'
_COMPARED_ROWS = 256


def heights_path(raster: Path | str) -> Path:
    raster = Path(raster)
    return raster.with_name(raster.name + _SUFFIX)


def map_heights(raster: Path | str, source: Any) -> Float32Array | None:
    """Return the prepared heights (H, W) of `source`, the open dataset of `raster`; None if there are none of its
    state.

    They are mapped copy-on-write: what is written to them stays in this process, and the arrays are of the type for
    which the kernels are compiled."""
    try:
        with heights_path(raster).open("rb") as file:
            found = os.fstat(file.fileno())
            if found.st_uid not in (0, os.geteuid(), Path(raster).stat().st_uid):
                return None
            if file.read(_HEADER_BYTES) != _header(source):
                return None
            if found.st_size != _HEADER_BYTES + 4 * source.height * source.width:
                return None
            mapped = np.memmap(file, np.float32, "c", _HEADER_BYTES, (source.height, source.width))
    except OSError:
        return None
    return mapped.view(np.ndarray)


def own_copy(heights: Float32Array) -> Float32Array:
    """Return a writable copy (H, W). Of prepared heights it is another mapping of their file, so that only modified
    pages use memory; a copy of 10,000 x 10,000 cells in memory would take 400 MB."""
    mapped: Any = heights
    while mapped is not None and not isinstance(mapped, np.memmap):
        mapped = getattr(mapped, "base", None)
    name = getattr(mapped, "filename", None)
    if name is None or mapped is None or mapped.shape != heights.shape or not Path(name).name.endswith(_SUFFIX):
        return heights.copy()
    try:
        with Path(name).open("rb") as file:
            if os.fstat(file.fileno()).st_size != _HEADER_BYTES + heights.nbytes:
                return heights.copy()
            again = np.memmap(file, np.float32, "c", _HEADER_BYTES, heights.shape).view(np.ndarray)
    except OSError:
        return heights.copy()
    # These heights may have been written to, at the seams of a stack, and the file may be another by now.
    for row in range(0, len(heights), _COMPARED_ROWS):
        part = slice(row, row + _COMPARED_ROWS)
        other = heights[part].view(np.uint32) != again[part].view(np.uint32)
        if other.any():
            again[part][other] = heights[part][other]
    return again


def _stale_makes_room(path: Path, raster: Path | str) -> None:
    """Remove prepared files of another state of the raster, which are never used again."""
    with contextlib.suppress(OSError):
        with path.open("rb") as file:
            ours = file.read(len(_MARK)) == _MARK
            owner = os.fstat(file.fileno()).st_uid
        if ours and owner in (os.geteuid(), Path(raster).stat().st_uid):
            path.unlink()


def write_heights(raster: Path | str, source: Any, read: Callable[[Float32Array], None]) -> Path | None:
    """Prepare `source`, the open dataset of `raster`; return the file, or None if it exists already or is not needed.

    `read`: writes the heights, (H, W) float32 of any content before, into its argument. Raises OSError where the file
    cannot be written; the previous file is kept then, unless it is of another state."""
    cells, path = source.height * source.width, heights_path(raster)
    if map_heights(raster, source) is not None:
        return None
    header = _header(source)
    # What will not be written over would stay for good where it is left of another state.
    if cells < LEAST_CELLS or header is None:
        _stale_makes_room(path, raster)
        return None
    needed = 4 * cells + SPARE_BYTES
    if free_bytes(path) < needed:
        _stale_makes_room(path, raster)
        if free_bytes(path) < needed:
            return None
    for left in path.parent.glob(f".{glob.escape(path.name)}.*"):  # by a process that was killed
        if not Path("/proc", left.suffix[1:]).exists():
            left.unlink(missing_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with partial.open("x+b") as file:
            with contextlib.suppress(PermissionError):  # of a file system without modes
                os.fchmod(file.fileno(), stat.S_IMODE(Path(raster).stat().st_mode) & 0o644)
            os.posix_fallocate(file.fileno(), 0, _HEADER_BYTES + 4 * cells)  # a full disk is an error, not a SIGBUS
            heights = np.memmap(file, np.float32, "r+", _HEADER_BYTES, (source.height, source.width))
            read(heights.view(np.ndarray))
            heights.flush()
            file.seek(0)
            file.write(header)
            file.flush()
            os.fsync(file.fileno())
        if _header(source) != header:  # the raster was written to meanwhile
            return None
        partial.replace(path)
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
    return path


def _header(source: Any) -> bytes | None:
    """Return what the prepared file of an open dataset begins with; None where its heights may lie in files that GDAL
    does not name. Raises OSError."""
    if source.driver == "VRT" or not source.files:
        return None
    files = []
    for name in sorted(source.files):
        found = Path(name).stat()
        files.append([Path(name).name, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns])
    text = json.dumps({"ltm heights": VERSION, "shape": [source.height, source.width], "files": files}) + "\n"
    return text.encode("ascii").ljust(_HEADER_BYTES, b" ") if len(text) <= _HEADER_BYTES else None
