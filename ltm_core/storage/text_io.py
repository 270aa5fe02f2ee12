"""Read text files and NumPy's own files (.npy, .npz) within bounds, without pickles.

A header may state any shape, and `numpy.load` reserves what it states; an entry of an .npz may unfold a thousandfold.
"""

from __future__ import annotations

import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from io import BytesIO
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import LtmError

LARGEST_TABLE = 4 << 20
"""Maximum size in bytes of a CSV file or of an index in JSON."""


def read_text(path: Path, most: int, error: type[LtmError], encoding: str = "utf-8") -> str:
    """Return the whole of a text file. Raises `error` for a missing file, more than `most` bytes, or invalid
    `encoding`."""
    try:
        with path.open("rb") as file:
            content = file.read(most + 1)
    except (OSError, ValueError) as reason:  # ValueError: a name that no file can have
        raise error(f"{path}: cannot be read ({getattr(reason, 'strerror', None) or reason})") from reason
    if len(content) > most:
        raise error(f"{path}: cannot be read (it has more than {most} bytes); split it")
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as reason:
        raise error(f"{path}: cannot be read (not text in UTF-8: {reason}); save it as UTF-8") from reason


_BROKEN = (
    *(OSError, ValueError, TypeError, LookupError, EOFError, SyntaxError, MemoryError, OverflowError),
    *(RuntimeError, zlib.error, zipfile.BadZipFile, tokenize.TokenError),
)
"""Errors that NumPy, the header's parser and zipfile raise for damaged bytes."""


def load_array(content: bytes, what: str, error: type[LtmError]) -> NDArray[Any]:
    """Return an array from the bytes of an .npy file; `what` names it in errors. Raises `error` for other bytes, a
    wrong size, and Python objects."""
    try:
        return _array(BytesIO(content), len(content))
    except _BROKEN as reason:
        raise error(f"{what} is damaged: not a NumPy array ({type(reason).__name__}: {reason})") from reason


def load_arrays(path: Path, names: Sequence[str], most_bytes: int, error: type[LtmError]) -> list[NDArray[Any]]:
    """Return these arrays of an .npz file. Raises `error` for a missing file or array, or more than `most_bytes`."""
    try:
        with zipfile.ZipFile(path) as archive:
            arrays = []
            for name in names:
                entry = archive.getinfo(f"{name}.npy")
                if entry.file_size > most_bytes:
                    raise ValueError(f"{name} has {entry.file_size} bytes, at most {most_bytes} are read")
                with archive.open(entry) as stream:
                    arrays.append(_array(stream, entry.file_size))  # type: ignore[arg-type]
            return arrays
    except _BROKEN as reason:
        raise error(f"{path}: expected an .npz with {', '.join(names)} ({type(reason).__name__}: {reason})") from reason


def _array(stream: BinaryIO, size: int) -> NDArray[Any]:
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(stream)
    if dtype.hasobject or min(shape, default=1) < 0 or prod(shape) * dtype.itemsize > size:
        raise ValueError(f"states {shape} of {dtype} in {size} bytes")
    values = np.frombuffer(stream.read(prod(shape) * dtype.itemsize), dtype)
    return values.reshape(shape[::-1]).T if fortran else values.reshape(shape)
