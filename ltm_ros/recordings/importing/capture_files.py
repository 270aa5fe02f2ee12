"""Read the files of a capture: members of a zip, or a folder. Sizes are limited, and no name in a zip becomes a
path."""

import csv
import io
import lzma
import struct
import zipfile
import zlib
from collections.abc import Collection, Iterator
from itertools import islice
from pathlib import Path, PurePosixPath

from ltm_core.base.errors import RecordingError

MOST_MEMBERS = 100_000
LARGEST_TABLE = 64 << 20
"""Maximum bytes of a CSV file: an hour of attitudes at 100 Hz has 55 MB."""
MOST_ROWS = 1_000_000
_BROKEN = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, EOFError, OSError),
    *(NotImplementedError, RuntimeError, ValueError, LookupError, OverflowError, MemoryError),
)
"""Exceptions of zipfile for corrupt, encrypted or unsupported archives."""


class CaptureFiles:
    """The files of a capture, by their names relative to `root`, with `/`. Raises RecordingError throughout."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._archive = None if path.is_dir() else self._opened()
        names = self._below() if self._archive is None else self._archive.namelist()
        self.names = [name for name in islice(names, MOST_MEMBERS + 1) if name and not name.endswith("/")]
        if len(self.names) > MOST_MEMBERS:
            raise RecordingError(f"{path}: the number of its files is more than {MOST_MEMBERS}: split the recording")

    def find(self, name: str) -> str | None:
        """Return the member of this name, in any case: the one nearest to a zip's top, or directly in a folder."""
        names = self.names if self._archive is not None else (n for n in self.names if "/" not in n)
        found = [n for n in names if PurePosixPath(n).name.lower() == name.lower()]
        return min(found, key=lambda n: (n.count("/"), n)) if found else None

    def read(self, name: str, most: int) -> bytes:
        """Return a member's bytes, at most `most` whatever the archive states."""
        place = f"{self.path}: {name!r}"
        try:
            opened = (self.path / name).open("rb") if self._archive is None else self._archive.open(name)
            with opened as member:
                data = member.read(most + 1)
        except _BROKEN as error:
            what = f"{place}: cannot be read ({type(error).__name__}: {error})"
            raise RecordingError(f"{what}; export the recording again, without a password") from error
        if len(data) > most:
            raise RecordingError(f"{place}: has more than {most >> 20} MiB unpacked: split the recording")
        return data

    def _opened(self) -> zipfile.ZipFile:
        try:
            return zipfile.ZipFile(self.path)
        except _BROKEN as error:
            what = f"{self.path}: is not a complete zip ({type(error).__name__}: {error})"
            raise RecordingError(f"{what}; export or copy it again") from error

    def _below(self) -> Iterator[str]:
        """Return the files in the folder and one level below."""
        for pattern in ("*", "*/*"):
            yield from (path.relative_to(self.path).as_posix() for path in self.path.glob(pattern) if path.is_file())


def is_zip(path: Path) -> bool:
    """Return whether it is a zip, by its first bytes."""
    try:
        with path.open("rb") as file:
            return file.read(4) in (b"PK\x03\x04", b"PK\x05\x06")
    except OSError:
        return False


def table(files: CaptureFiles, name: str, wanted: Collection[str]) -> dict[str, list[str]]:
    """Return the available wanted columns of a CSV with a header; blanks beside commas are removed.

    Raises RecordingError for an invalid CSV, or rows that are too short, except the last one, if a phone died."""
    place = f"{files.path}: {name!r}"
    lines = io.TextIOWrapper(io.BytesIO(files.read(name, LARGEST_TABLE)), "utf-8-sig", newline="")
    rows = csv.reader(lines, skipinitialspace=True)
    try:
        header = [column.strip() for column in next(rows, [])]
        if not header or len(set(header)) < len(header):
            raise RecordingError(f"{place}: its first line is not a header of different columns, got {header[:8]}")
        columns: dict[str, list[str]] = {column: [] for column in header if column in wanted}
        places = {column: header.index(column) for column in columns}
        for row in filter(None, rows):
            if rows.line_num > MOST_ROWS:
                raise RecordingError(f"{place}: has more than {MOST_ROWS} rows: split the recording")
            if len(row) < len(header):
                number = rows.line_num
                if next(rows, None):
                    raise RecordingError(f"{place}, line {number}: has fewer values than the {len(header)} columns")
                break
            for column, values in columns.items():
                values.append(row[places[column]].strip())
    except (csv.Error, UnicodeDecodeError) as error:
        what = "not text in UTF-8" if isinstance(error, UnicodeDecodeError) else "no CSV"
        raise RecordingError(f"{place} is {what} ({error}); export the recording again") from error
    return columns
