"""What an upgrade compiles before the tower is stopped."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import yaml
from scenes.small_site import write_small_site

from ltm_core.site.site_io import load_site
from ltm_ros.launching.graph import describe


def test_kernels_are_compiled_without_the_nodes_that_ask_cameras(tmp_path: Path) -> None:
    """The former release is at the camera still, and some cameras serve one at a time."""
    small = write_small_site(tmp_path, recording=False)
    content = yaml.safe_load(small.path.read_text())
    del content["cameras"]["mast"]["image"]
    content["cameras"]["mast"]["source"] = {"kind": "snapshot", "url": "http://127.0.0.1:9/snapshot.jpg"}
    small.path.write_text(yaml.safe_dump(content))
    kinds = [node.module.rpartition(".")[2] for node in describe(load_site(small.path), small.path)]
    assert kinds.count("source") == 1
    command = [sys.executable, "-m", "ltm_ros.tower.compile_kernels", str(small.path)]
    ran = subprocess.run(command, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.startswith(f"compiled the kernels of {len(kinds) - 1} nodes")
