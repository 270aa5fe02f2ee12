"""Find the files of archives, and write results that appear completely or not at all."""

import os
import shutil
from pathlib import Path


def files_below(archive: Path) -> list[Path]:
    """Return a file, or the files in a folder at any depth, by name, also behind links, each folder once; none if
    nothing exists. A broken link, as to an unmounted share, counts as an unreadable file and is not skipped. Raises
    OSError also for an unreadable folder, unlike `Path.rglob`."""
    top = archive.expanduser().resolve()

    def failed(error: OSError) -> None:
        if not (isinstance(error, FileNotFoundError) and error.filename == str(top)):
            raise error

    found, known = [top] if top.is_file() else [], set[str]()
    for place, below, names in os.walk(top, onerror=failed, followlinks=True) if not found else ():
        real = os.path.realpath(place)
        if real in known:  # a link to a parent folder, or to one that is in the archive itself
            below.clear()
            continue
        known.add(real)
        below.sort()
        found += [Path(place) / name for name in names]
    return sorted(path for path in found if path.is_file() or path.is_symlink())


def write_result(path: Path, content: bytes | Path) -> None:
    """Write bytes, or a copy of a file, completely or not at all, also in a power cut. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    try:
        if isinstance(content, Path):
            shutil.copyfile(content, partial)
        else:
            partial.write_bytes(content)
        with partial.open("rb") as file:
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError:
        partial.unlink(missing_ok=True)
        raise
