"""Small file systems that only this run sees, so that they can be filled without harm to anybody."""

import os
import subprocess
import sys
from pathlib import Path

_INSIDE = "LTM_CHAOS_MOUNTS"


def enter_own_mounts() -> bool:
    """Go on in a mount namespace of our own, whose mounts end with us; False where the machine does not let us.

    Starts the program anew in there, so call it first.
    """
    if _INSIDE in os.environ:
        return True
    for how in (["unshare", "--mount"], ["unshare", "--map-root-user", "--mount"]):
        trial = [*how, "mount", "-t", "tmpfs", "tmpfs", "/mnt"]
        try:
            allowed = subprocess.run(trial, capture_output=True).returncode == 0
        except OSError:
            return False
        if allowed:
            os.environ[_INSIDE] = "1"
            os.execvp(how[0], [*how, sys.executable, "-m", "chaos", *sys.argv[1:]])
    return False


def mount_disk(folder: Path, megabytes: int) -> None:
    """A file system of that size in a folder, which is made; after `enter_own_mounts`."""
    folder.mkdir(parents=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", str(folder)], check=True)


def unmount_disk(folder: Path) -> None:
    """With all that lies there; so that the folder can be removed."""
    subprocess.run(["umount", "--lazy", str(folder)], check=False)
