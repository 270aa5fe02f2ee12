"""Reads text files no larger than a bound: what is made for a person to write is small, whatever the file says."""

from __future__ import annotations

from pathlib import Path

from ltm_core.errors import LtmError

LARGEST_TABLE = 4 << 20
"""Bytes of a CSV file, or of an index in JSON."""


def read_text(path: Path, most: int, error: type[LtmError], encoding: str = "utf-8") -> str:
    """The whole of a text file. Raises `error`: no file, more than `most` bytes, or other bytes than `encoding` has."""
    try:
        with path.open("rb") as file:
            content = file.read(most + 1)
    except (OSError, ValueError) as reason:  # ValueError: a name that no file can have
        raise error(f"{path}: cannot be read ({getattr(reason, 'strerror', None) or reason})") from reason
    if len(content) > most:
        raise error(f"{path}: cannot be read (it has more than {most} bytes: no such file is that large); split it")
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as reason:
        raise error(f"{path}: cannot be read (not text in UTF-8: {reason}); save it as UTF-8") from reason
