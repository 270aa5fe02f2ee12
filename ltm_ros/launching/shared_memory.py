"""Find and remove the shared memory that Fast DDS leaves in /dev/shm; as a program, print that of a ROS process.

A segment or port of Fast DDS is a file with a lock file beside it (`_el` exclusive, `_sl` shared), on which its owner
holds a flock while it lives; the kernel releases the lock when the owner dies. A port also has a semaphore. Only
objects without a living owner are removed, so other graphs on the machine are safe."""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from ltm_ros.runtime.ros_environment import limit_shutdown

SHM_FOLDER = Path("/dev/shm")  # nosec B108 # not ours: the system's shared memory

# A participant locks a file shortly after creating it; younger files may not be locked yet.
MIN_AGE_S = 1.0

BYTES_PER_PARTICIPANT = 72 << 20
"""Space in bytes that a node takes in /dev/shm with config/fastdds.xml (Fast DDS allocates its segment in full at the
start)."""

_OBJECT = re.compile(r"^(?:sem\.)?(?P<base>fastrtps_(?:port\d{1,5}|[0-9a-f]{16}))(?:_el|_sl|_mutex)?$")

_LOCKED_FILE = re.compile(r" ([0-9a-f]+):([0-9a-f]+):(\d+) ")


@dataclass(frozen=True)
class SharedMemory:
    """The objects of Fast DDS in /dev/shm: names of segments and ports, each with its files."""

    in_use: tuple[str, ...]
    stale: tuple[str, ...]
    young: tuple[str, ...]
    """Not locked, but so new that its owner may still lock it."""
    stale_bytes: int

    @property
    def segments_in_use(self) -> int:
        return sum(1 for name in self.in_use if "port" not in name)


def survey(folder: Path = SHM_FOLDER, min_age_s: float = MIN_AGE_S) -> SharedMemory:
    """List every Fast DDS object in `folder`. Changes nothing and takes no locks, so it cannot disturb a starting
    participant or a cleanup. Objects of another PID namespace count as stale, because their locks are invisible."""
    return _walk(folder, min_age_s, remove=False)


def remove_stale(folder: Path = SHM_FOLDER, min_age_s: float = MIN_AGE_S) -> SharedMemory:
    """Remove the objects of dead processes. Objects of other users that cannot be removed stay."""
    return _walk(folder, min_age_s, remove=True)


def free_bytes(folder: Path = SHM_FOLDER) -> int | None:
    """Return the free space in /dev/shm in bytes; None if it does not exist."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None


def _walk(folder: Path, min_age_s: float, remove: bool) -> SharedMemory:
    objects: dict[str, list[Path]] = {}
    try:
        entries = sorted(folder.iterdir())
    except OSError:
        entries = []
    for path in entries:
        match = _OBJECT.match(path.name)
        if match:
            objects.setdefault(match["base"], []).append(path)
    mapped = _mapped_names(folder) if objects else set()
    held = None if remove else _held_locks()
    in_use: list[str] = []
    stale: list[str] = []
    young: list[str] = []
    stale_bytes = 0
    for base, paths in objects.items():
        # Peers keep a dead owner's segment mapped for a while, so only its lock counts. A port is a queue that
        # senders map without a lock; an object without a lock file can only be judged by its mappings.
        if base in mapped and ("port" in base or not any(map(_is_lock, paths))):
            in_use.append(base)
            continue
        if _age_s(paths) < min_age_s:
            young.append(base)
            continue
        if held is None:
            locks = _take_locks(paths)
        else:
            locks = None if any(_file_key(path) in held for path in filter(_is_lock, paths)) else []
        if locks is None:
            in_use.append(base)
            continue
        try:
            stale.append(base)
            stale_bytes += sum(_allocated_bytes(path) for path in paths)
            if remove:
                # Lock files are removed last, while we hold them: a new participant that opens one then waits for a
                # deleted file and creates its own.
                for path in sorted(paths, key=_is_lock):
                    _unlink(path)
        finally:
            for descriptor in locks:
                os.close(descriptor)
    return SharedMemory(tuple(in_use), tuple(stale), tuple(young), stale_bytes)


def _is_lock(path: Path) -> bool:
    return path.name.endswith(("_el", "_sl"))


def _held_locks() -> frozenset[tuple[int, int, int]] | None:
    """Return the files locked by processes of this PID namespace, by device numbers and inode; None if unknown
    (proc(5))."""
    try:
        content = Path("/proc/locks").read_text()
    except OSError:
        return None
    keys = (_LOCKED_FILE.search(line) for line in content.splitlines())
    return frozenset((int(key[1], 16), int(key[2], 16), int(key[3])) for key in keys if key)


def _file_key(path: Path) -> tuple[int, int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return os.major(status.st_dev), os.minor(status.st_dev), status.st_ino


def _take_locks(paths: list[Path]) -> list[int] | None:
    """Return descriptors that hold every lock file of one object, or None if another process holds one."""
    descriptors: list[int] = []
    for path in filter(_is_lock, paths):
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        except FileNotFoundError:
            continue
        except OSError:
            break
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(descriptor)
            break
        descriptors.append(descriptor)
    else:
        return descriptors
    for descriptor in descriptors:
        os.close(descriptor)
    return None


def _mapped_names(folder: Path) -> set[str]:
    """Return the base names of the objects that visible processes have mapped; senders map ports without a lock."""
    names: set[str] = set()
    prefix = f"{folder}/fastrtps_"
    for maps in Path("/proc").glob("[0-9]*/maps"):
        try:
            content = maps.read_text(errors="replace")
        except OSError:
            continue
        if prefix not in content:
            continue
        for line in content.splitlines():
            path = line[line.find("/") :] if prefix in line else ""
            match = _OBJECT.match(Path(path).name) if path and not path.endswith("(deleted)") else None
            if match:
                names.add(match["base"])
    return names


def _age_s(paths: list[Path]) -> float:
    newest = 0.0
    for path in paths:
        try:
            newest = max(newest, path.stat().st_ctime)
        except OSError:
            continue
    # A future time means that the clock was set back, so the file is not new.
    return abs(time.time() - newest)


def _allocated_bytes(path: Path) -> int:
    try:
        return path.stat().st_blocks * 512
    except OSError:
        return 0


def _unlink(path: Path) -> None:
    try:
        path.unlink()
    except OSError:
        return


def own_segment_bytes() -> list[int]:
    """Return the sizes of the shared-memory segments that this process created, largest first."""
    sizes = set()
    for link in Path("/proc/self/fd").iterdir():
        try:
            lock = link.readlink()
        except OSError:
            continue
        segment = lock.with_name(lock.name.removesuffix("_el"))
        if lock.parent == SHM_FOLDER and lock.name.endswith("_el") and "_port" not in lock.name:
            sizes.add((segment.name, segment.stat().st_size))
    return sorted((size for _, size in sizes), reverse=True)


def main() -> None:
    import rclpy

    rclpy.init()
    node = rclpy.create_node("ltm_transport_probe", enable_rosout=False)
    print(json.dumps({"rmw": rclpy.get_rmw_implementation_identifier(), "segment_bytes": own_segment_bytes()}))
    sys.stdout.flush()
    limit_shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
