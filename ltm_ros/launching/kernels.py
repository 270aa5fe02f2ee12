"""Compile the kernels of a graph's nodes on all cores before it starts: `python -m ltm_ros.launching.kernels SITE`.

An upgrade does this while the previous release still runs, so that the tower stops for seconds instead of minutes."""

import contextlib
import os
import platform
import subprocess  # nosec B404 # argument lists, no shell
import sys
import time
from collections.abc import Callable
from pathlib import Path

import ltm_core
from ltm_core.base.numba_cache import kernel_level, use_own_cache
from ltm_core.pipeline.kernels import KERNELS, compile_kernels
from ltm_core.site.site_io import load_site
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.supervised import end_with_parent
from ltm_ros.runtime.ros_environment import available_cores, ros_environment


def compile_ahead(
    graph: Graph, site_path: Path | str, console: Callable[[str], object], waiting: Callable[[], object] = bool
) -> None:
    """Compile the kernels of a graph's nodes, unless that was done; print when it begins and how long it took. Nodes
    compile what is still missing when they start; with a user's NUMBA_CACHE_DIR, everything. `waiting` is called five
    times a second."""
    folder = use_own_cache(Path(ltm_core.__file__).parent)
    if folder is None or os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        return
    used = {node.executable for node in graph}
    kinds = [kind for kind in KERNELS if kind in used and not compiled_mark(folder, kind).exists()]
    if not kinds:
        return
    before, begun = _count(folder), time.monotonic()
    console(f"-- compiling the kernels of {', '.join(kinds)}, once for this version")
    workers = min(available_cores(), len(kinds))
    command = [sys.executable, "-m", __name__, str(site_path), "--kinds"]
    # Sessions of their own: Ctrl-C must end only the parent, which ends them.
    running = [
        subprocess.Popen(  # nosec B603 # no shell
            [*command, *kinds[number::workers]],
            env=ros_environment(busy=False),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        for number in range(workers)
    ]
    try:
        while any(process.poll() is None for process in running):
            waiting()
            time.sleep(0.2)
    finally:
        for process in running:
            process.kill()
            process.wait()
    if any(process.returncode for process in running):
        console("-- not all kernels could be compiled; the nodes will do it")
        return
    console(f"-- compiled {_count(folder) - before} kernels in {time.monotonic() - begun:.0f} s")
    with contextlib.suppress(OSError):
        for kind in kinds:
            compiled_mark(folder, kind).touch()


def compiled_mark(folder: Path, kind: str) -> Path:
    """Return the file that marks the kernels of a kind of node as compiled for this machine's processor, or for the
    level of processors that the folder is for."""
    return folder / f"{kind}-{kernel_level(folder) or platform.node()}.compiled"


def _count(folder: Path) -> int:
    return sum(1 for _ in folder.rglob("*.nbi"))


def main() -> None:
    """Compile the kernels of all nodes of a site, or of the kinds after `--kinds`."""
    path, *kinds = sys.argv[1:]
    site = load_site(path)
    if kinds:
        end_with_parent()
        for kind in kinds[1:]:
            compile_kernels(kind, site)
    else:
        compile_ahead(describe(site, path, sources=False), path, print)


if __name__ == "__main__":
    main()
