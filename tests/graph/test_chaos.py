from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.graph, pytest.mark.slow]

TESTS = Path(__file__).parents[1]


@pytest.mark.usefixtures("kernels")
def test_a_minute_of_chaos(ros_domain: int, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "chaos", "--minutes", "1", "--seed", "11", "--domain", str(ros_domain)]
    # Beside other graphs a node may take longer to start than it may when it has the machine for itself.
    command += ["--slack", "4", "--json", str(tmp_path / "found.json"), "--folder", str(tmp_path / "run")]
    paths = [str(TESTS), str(TESTS / "graph"), str(TESTS.parent)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["faults"]
    assert found["verdict"]["told"] > 20
