"""Compile the kernels of all nodes for two levels of x86-64 into a copy of the source, before a wheel is made of it.

`python packaging/precompile.py FOLDER`, with the Python and numba that will run them. They are used as they are on any
processor of the level (`ltm_core/base/numba_cache.py`); a kernel for other types is compiled at its first call.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

SITE = Path(__file__).resolve().parents[1] / "bags/demo/site.yaml"
LEVEL, FEATURES = "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES"


def precompile(source: Path) -> None:
    """Add `ltm_core/precompiled` to a folder with the product's packages. The two levels are compiled in parallel."""
    from ltm_core.base.numba_cache import CPU_LEVELS, PRECOMPILED, cpu_flags, levels_of

    if missing := sorted(set(CPU_LEVELS) - set(levels_of(cpu_flags()))):
        raise SystemExit(f"this processor cannot run {', '.join(missing)}: build on a newer one")
    target = source / "ltm_core" / PRECOMPILED
    shutil.rmtree(target, ignore_errors=True)
    with tempfile.TemporaryDirectory() as folder:
        running = []
        for level in CPU_LEVELS:
            copy = Path(folder) / level
            shutil.copytree(source, copy, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
            environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
            environment |= {"PYTHONPATH": str(copy), LEVEL: level, FEATURES: ""}
            running.append(
                subprocess.Popen([sys.executable, __file__, str(target), level], env=environment, cwd=folder)
            )
        codes = [process.wait() for process in running]
        if any(codes):
            raise SystemExit("the kernels cannot be compiled")


def compile_level(target: Path, level: str) -> None:
    """Compile all kernels with the source on the path of this process, and keep them below `target`."""
    import ltm_core
    from ltm_core.base.numba_cache import precompiled_name, use_own_cache
    from ltm_core.pipeline.kernels import KERNELS, compile_kernels
    from ltm_core.site.site_io import load_site

    site = load_site(SITE)
    for kind in KERNELS:
        compile_kernels(kind, site)
    folder = use_own_cache(Path(ltm_core.__file__).parent)
    assert folder is not None
    state = folder.name.rpartition("-")[2]
    for kind in KERNELS:
        (folder / f"{kind}-{level}.compiled").touch()
    shutil.copytree(folder, target / precompiled_name(state, level))


if __name__ == "__main__":
    if len(sys.argv) == 2:
        sys.path.insert(0, sys.argv[1])
        precompile(Path(sys.argv[1]).resolve())
    else:
        compile_level(Path(sys.argv[1]), sys.argv[2])
