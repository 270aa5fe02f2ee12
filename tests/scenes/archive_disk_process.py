"""`ltm reprocess` onto a small disk: `unshare -m python archive_disk_process.py CASE MOUNT_POINT SITE_FOLDER`."""

from pathlib import Path
from typing import Any

from ltm_core.base.errors import LtmError
from ltm_ros.archive.run import ArchiveOptions, Summary, look_through, run
from ltm_ros.archive.task import serial
from scenes.own_disk import answer, fill, make_disk
from scenes.small_site import SmallSite


def reprocessed(site: SmallSite, out: Path, after: Any = lambda done, total: None) -> Summary:
    options = ArchiveOptions((site.bag,), site.path, out, frames_per_task=1)
    return run(look_through(options, lambda done, total: None), serial, after)


def full(disk: Path, folder: Path) -> dict[str, Any]:
    """The disk fills up when a third of the tasks are done; then there is room again."""
    make_disk(disk, "32m")
    site, ballast = SmallSite(folder), list[Path]()

    def fill_up(done: int, total: int) -> None:
        if done == total // 3 and not ballast:
            ballast.append(fill(disk))

    try:
        reprocessed(site, disk / "out", fill_up)
        said = ""
    except (LtmError, OSError) as error:
        said = str(error)
    left = {file.name for file in (disk / "out").rglob("*") if file.is_file()}
    ballast[0].unlink()
    again = reprocessed(site, disk / "out")
    return {
        "said": said,
        "maps": sorted(name for name in left if name.startswith("fuel_map")),
        "partial": sorted(name for name in left if "partial" in name),
        "worked": again.worked,
        "digest": again.digest,
        "frames": again.merged,
    }


if __name__ == "__main__":
    answer({"full": full})
