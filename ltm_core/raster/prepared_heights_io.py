"""Decoded heights of a large raster in a NumPy file beside it, which all processes of a site map into memory.

A raster of 10,000 x 10,000 cells takes 400 MB in each process that decodes it, and seconds. The name of its prepared
file, `<raster>.<state>.ltm-heights.npy`, holds the state of the raster: the inode, size and times of its files, among
them `ctime`, which no program can set. A prepared file of an owner who is neither this process's, nor the raster's, nor
root counts as absent: users with access to the folder could replace the heights of a raster that they may not write."""

import contextlib
import glob
import os
import stat
import tempfile
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from ltm_core.base.types import Float32Array
from ltm_core.storage.disk_io import free_bytes

VERSION = 3
"""Version of the preparation; increase it when the same raster gives other heights."""
LEAST_CELLS = 16 << 20
"""Minimum number of cells of a raster for a prepared file (64 MB); a smaller one is decoded in half a second."""
SPARE_BYTES = 1 << 30
"""Minimum free space on the disk in bytes."""
_SUFFIX = ".ltm-heights.npy"


def heights_path(raster: Path | str, source: Any) -> Path | None:
    """Return the prepared file of `source`, the open dataset of `raster`; None where its heights may lie in files that
    GDAL does not name. Raises OSError."""
    if source.driver == "VRT" or not source.files:
        return None
    state: list[object] = [VERSION, source.height, source.width]
    for name in sorted(source.files):
        found = Path(name).stat()
        state += [Path(name).name, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns]
    raster = Path(raster)
    return raster.with_name(f"{raster.name}.{sha256(repr(state).encode()).hexdigest()[:16]}{_SUFFIX}")


def map_heights(raster: Path | str, source: Any) -> Float32Array | None:
    """Return the prepared heights (H, W) of `source`, the open dataset of `raster`; None if there are none. They are
    mapped copy-on-write: what is written to them stays in this process."""
    try:
        path = heights_path(raster, source)
        if path is None:
            return None
        with path.open("rb") as file:
            if os.fstat(file.fileno()).st_uid not in (0, os.geteuid(), Path(raster).stat().st_uid):
                return None
            npy.read_magic(file)
            if npy.read_array_header_1_0(file) != ((source.height, source.width), False, np.dtype(np.float32)):
                return None
            mapped = np.memmap(file, np.float32, "c", file.tell(), (source.height, source.width))
    except (OSError, ValueError):  # no such file, or a damaged one
        return None
    return mapped.view(np.ndarray)


def own_copy(heights: Float32Array) -> Float32Array:
    """Return a writable copy (H, W). Of prepared heights it is another mapping of their file, so that only modified
    pages use memory; a copy of 10,000 x 10,000 cells in memory would take 400 MB."""
    mapped: Any = heights
    while mapped is not None and not isinstance(mapped, np.memmap):
        mapped = getattr(mapped, "base", None)
    if mapped is None or mapped.filename is None or mapped.shape != heights.shape:
        return heights.copy()
    try:
        again: Any = np.memmap(mapped.filename, np.float32, "c", mapped.offset, heights.shape)
        return np.asarray(again.view(np.ndarray), np.float32)
    except OSError:  # the file has been removed
        return heights.copy()


def write_heights(raster: Path | str, source: Any, read: Callable[[Float32Array], None]) -> Path | None:
    """Prepare `source`, the open dataset of `raster`, and remove the files of its former states; return the file, or
    None if it exists already or is not needed.

    `read`: writes the heights into an array (H, W) float32. Raises OSError where the file cannot be written."""
    path, shape = heights_path(raster, source), (source.height, source.width)
    if map_heights(raster, source) is not None:
        return None
    raster = Path(raster)
    for former in raster.parent.glob(f"{glob.escape(raster.name)}.*{_SUFFIX}*"):
        former.unlink(missing_ok=True)
    needed = 4 * shape[0] * shape[1]
    if path is None or needed < 4 * LEAST_CELLS or free_bytes(path) < needed + SPARE_BYTES:
        return None
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.name)
    try:
        with os.fdopen(handle, "w+b") as file:
            with contextlib.suppress(PermissionError):  # of a file system without modes
                os.fchmod(file.fileno(), stat.S_IMODE(raster.stat().st_mode) & 0o644)
            npy.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})
            begin = file.tell()
            os.posix_fallocate(file.fileno(), 0, begin + needed)  # a full disk is an error, not a SIGBUS
            heights = np.memmap(file, np.float32, "r+", begin, shape)
            read(heights.view(np.ndarray))
            heights.flush()
            os.fsync(file.fileno())
        if heights_path(raster, source) != path:  # the raster was written to meanwhile
            return None
        Path(name).replace(path)
    finally:
        Path(name).unlink(missing_ok=True)
    return path
