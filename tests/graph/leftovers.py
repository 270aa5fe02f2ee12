"""What a graph may have left on the machine: processes, shared-memory ports and segments."""

import contextlib
import os
import time
from collections.abc import Callable
from pathlib import Path

from ltm_ros.launching import shared_memory


def processes_of_domain(domain: int) -> list[str]:
    """Command lines of the processes that were started with this domain in their environment; without the one that
    Python keeps beside a process that has started others by `multiprocessing`, as a live replay does for its check."""
    found = []
    mark = f"ROS_DOMAIN_ID={domain}".encode()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if mark in (folder / "environ").read_bytes().split(b"\0") and int(folder.name) != os.getpid():
                command = (folder / "cmdline").read_bytes().replace(bytes(1), b" ").decode()
                if "multiprocessing.resource_tracker" not in command:
                    found.append(f"{folder.name}: {command}")
        except OSError:
            continue
    return found


def ports_of_domain(domain: int) -> list[str]:
    """Shared-memory ports of a domain's participants; DDS numbers them 250 a domain from 7400 on."""
    first, names = 7400 + 250 * domain, [path.name for path in shared_memory.SHM_FOLDER.glob("fastrtps_port*")]
    numbers = {name: name.removeprefix("fastrtps_port") for name in names}
    return [name for name, number in numbers.items() if number.isdecimal() and first <= int(number) < first + 250]


def owned_by_process(pid: int) -> set[str]:
    """Shared-memory segments and ports that a process owns: it has their lock files open. What it has only mapped may
    be of another domain, whose processes go on sending to a port by its number when its owner has changed."""
    names = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # one that the process has closed meanwhile
            names.add(link.readlink().name)
    return {name[:-3] for name in names if name.startswith("fastrtps_") and name.endswith("_el")}


def segments(names: set[str]) -> set[str]:
    return {name for name in names if "port" not in name}


def ports_of_process(pid: int) -> list[str]:
    """Shared-memory ports that a process has mapped, those that are removed with `(deleted)` behind."""
    lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    names = {line.partition(f"{shared_memory.SHM_FOLDER}/fastrtps_")[2] for line in lines if "/fastrtps_port" in line}
    return sorted(names)


def wait_gone(look: Callable[[], list[str]], patience_s: float = 5.0) -> list[str]:
    """What `look` still finds after `patience_s`; empty as soon as it finds nothing."""
    deadline = time.monotonic() + patience_s
    while (left := look()) and time.monotonic() < deadline:
        time.sleep(0.1)
    return list(left)
