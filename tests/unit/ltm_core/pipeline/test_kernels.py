import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from scenes.small_site import write_small_site

CODE = """
import json, sys
from ltm_core.pipeline.kernels import compile_kernels
from ltm_core.site.site_io import load_site
from scenes.kernel_counts import compiled
compile_kernels("terrain", load_site(sys.argv[1]))
print(json.dumps(compiled()))
"""


@pytest.mark.slow
def test_that_of_things_seen_through_is_ready_before_any_is(tmp_path: Path) -> None:
    """In a process of its own: in this one other tests have compiled."""
    paths = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    site = str(write_small_site(tmp_path, recording=False).path)
    run = subprocess.run([sys.executable, "-c", CODE, site], env=paths, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    kernels = {name: count for name, count in json.loads(run.stdout).items() if ".free_space." in name}
    assert kernels
    assert all(count > 0 for count in kernels.values()), kernels
