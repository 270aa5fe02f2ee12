"""What a terrain node compiles before it says that it is ready."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

CODE = """
import json
from ltm_core.surface.config import TerrainConfig
from ltm_core.surface.compiled_kernels import compile_kernels
from scenes.kernel_counts import compiled
compile_kernels(TerrainConfig())
print(json.dumps(compiled()))
"""


@pytest.mark.slow
def test_that_of_things_seen_through_is_ready_before_any_is() -> None:
    """In a process of its own: in this one other tests have compiled."""
    paths = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run([sys.executable, "-c", CODE], env=paths, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    kernels = {name: count for name, count in json.loads(run.stdout).items() if ".free_space." in name}
    assert len(kernels) > 1
    assert all(count > 0 for count in kernels.values()), kernels
