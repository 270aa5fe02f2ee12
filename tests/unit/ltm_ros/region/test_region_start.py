"""A region's map answers its first frame as quickly as any: what that needs is there before it says so."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from scenes.region_scene import write_region_scene


def test_nothing_is_compiled_or_imported_after_the_start(tmp_path: Path) -> None:
    """In a process of its own: in this one other tests have done both."""
    scene = write_region_scene(tmp_path, tiles=1e-9)
    (tmp_path / "frame").write_bytes(scene.sealed("alta", 1))
    code = Path(__file__).with_name("frames_after_start.py")
    paths = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run([sys.executable, code, tmp_path], env=paths, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    before, after, imported = json.loads(run.stdout)
    assert before["ltm_core.fuel.evidence_kernel.accumulate"] == 1
    assert after == before
    assert imported == []
