"""A small disk that only one process sees: a tmpfs in a mount namespace of its own."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

TESTS = Path(__file__).parents[1]


def run_on_own_disk(
    program: Path, case: str, *arguments: Path | str, patience_s: float = 300.0, more: Mapping[str, str] | None = None
) -> Any:
    """What `case` of a program, which ends with `answer`, returns; `more`: variables of its environment.

    Skips, with the reason, where nothing is mounted.
    """
    return run_on_own_disks(program, [case], *arguments, patience_s=patience_s, more=more)[case]


def run_on_own_disks(
    program: Path,
    cases: Sequence[str],
    *arguments: Path | str,
    patience_s: float = 300.0,
    more: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """The same of several cases, one after the other in one process, each on a disk of its own."""
    if shutil.which("unshare") is None:
        pytest.skip("needs `unshare` for a file system of its own")
    alone = ["unshare", "-m"] if os.geteuid() == 0 else ["unshare", "--user", "--map-root-user", "-m"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(TESTS), str(TESTS.parent)])} | dict(more or {})
    command = [*alone, sys.executable, str(program), ",".join(cases), *map(str, arguments)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=patience_s)
    if done.returncode != 0 and "unshare" in done.stderr:
        pytest.skip(f"no mount namespace here: {done.stderr.strip()[:200]}")
    assert done.returncode == 0, done.stderr[-3000:]
    said = json.loads(done.stdout.splitlines()[-1])
    if "no mounts here" in said:
        pytest.skip(f"cannot mount a file system here: {said['no mounts here'][:200]}")
    answers: dict[str, Any] = said["answers"]
    return answers


def mount(folder: Path, *options: str) -> None:
    subprocess.run(["mount", *options, str(folder)], check=True, capture_output=True)


def answer(cases: dict[str, Callable[..., Any]]) -> None:
    """Body of such a program: `CASE,CASE,... MOUNT_POINT ...`; the rest of the command line goes to each case as paths,
    after the folder that its disk is to be mounted on."""
    names, mount_point, *rest = sys.argv[1:]
    try:
        subprocess.run(["mount", "--make-rprivate", "/"], check=True, capture_output=True)
        mount(Path(mount_point), "-t", "tmpfs", "tmpfs")
    except (OSError, subprocess.CalledProcessError) as error:
        print(json.dumps({"no mounts here": str(error)}))
        sys.exit()
    answers = {}
    for name in names.split(","):
        disk = Path(mount_point, name)
        disk.mkdir()
        answers[name] = cases[name](disk, *map(Path, rest))
    print(json.dumps({"answers": answers}))


def make_disk(folder: Path, size: str, inodes: int = 0) -> None:
    """`inodes`: names that it has room for, its own counted; 0: any number."""
    mount(folder, "-t", "tmpfs", "-o", f"size={size},nr_inodes={inodes}", "tmpfs")


def fill(folder: Path) -> Path:
    """A file that takes what is free; remove it to have room again."""
    ballast = folder / "ballast"
    room = os.statvfs(folder)
    with ballast.open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, max(1, room.f_bavail * room.f_frsize))
    return ballast
