"""Remove the shared memory that killed processes leave in /dev/shm (Fast DDS).

A segment or port of Fast DDS is a file with a lock file beside it (`_el` exclusive, `_sl` shared), on which its owner
holds a flock while it lives; the kernel releases the lock when the owner dies. A port also has a semaphore. Only
objects without a living owner are removed, so other graphs on the machine are safe."""

import contextlib
import fcntl
import os
import re
import shutil
import time
from pathlib import Path

SHM_FOLDER = Path("/dev/shm")  # nosec B108 # not ours: the system's shared memory

# A participant locks a file shortly after creating it; younger files may not be locked yet.
MIN_AGE_S = 1.0

BYTES_PER_PARTICIPANT = 72 << 20
"""Space in bytes that a node takes in /dev/shm with config/fastdds.xml (Fast DDS allocates its segment in full at the
start)."""

_OBJECT = re.compile(r"^(?:sem\.)?(?P<base>fastrtps_(?:port\d{1,5}|[0-9a-f]{16}))(?:_el|_sl|_mutex)?$")


def free_bytes(folder: Path = SHM_FOLDER) -> int | None:
    """Return the free space in /dev/shm in bytes; None if it does not exist."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None


def remove_stale(folder: Path = SHM_FOLDER, min_age_s: float = MIN_AGE_S) -> bool:
    """Remove the objects of dead processes; those of other users stay. Return whether there are objects so new that
    their owner may still lock them."""
    objects: dict[str, list[Path]] = {}
    with contextlib.suppress(OSError):
        for path in sorted(folder.iterdir()):
            if match := _OBJECT.match(path.name):
                objects.setdefault(match["base"], []).append(path)
    mapped, young = _mapped_names(folder) if objects else set(), False
    for base, paths in objects.items():
        # Peers keep a dead owner's segment mapped for a while, so only its lock counts. A port is a queue that
        # senders map without a lock; an object without a lock file can only be judged by its mappings.
        if base in mapped and ("port" in base or not any(map(_is_lock, paths))):
            continue
        changed = [0.0]
        for path in paths:
            with contextlib.suppress(OSError):
                changed.append(path.stat().st_ctime)
        if abs(time.time() - max(changed)) < min_age_s:  # a future time means that the clock was set back
            young = True
            continue
        with contextlib.ExitStack() as held:
            if _take_locks(paths, held):
                # Lock files are removed last, while we hold them: a new participant that opens one then waits for a
                # deleted file and creates its own.
                for path in sorted(paths, key=_is_lock):
                    with contextlib.suppress(OSError):
                        path.unlink()
    return young


def _is_lock(path: Path) -> bool:
    return path.name.endswith(("_el", "_sl"))


def _take_locks(paths: list[Path], held: contextlib.ExitStack) -> bool:
    """Lock every lock file of one object until `held` ends; return False if another process holds one."""
    for path in filter(_is_lock, paths):
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            held.callback(os.close, descriptor)
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except FileNotFoundError:
            continue
        except OSError:
            return False
    return True


def _mapped_names(folder: Path) -> set[str]:
    """Return the base names of the objects that visible processes have mapped; senders map ports without a lock."""
    names: set[str] = set()
    for maps in Path("/proc").glob("[0-9]*/maps"):
        with contextlib.suppress(OSError):
            for line in maps.read_text(errors="replace").splitlines():
                _, found, name = line.partition(f"{folder}/")
                if found and not name.endswith("(deleted)") and (match := _OBJECT.match(name)):
                    names.add(match["base"])
    return names
