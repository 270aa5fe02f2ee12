import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.graph, pytest.mark.slow]

TESTS = Path(__file__).parents[1]


@pytest.mark.usefixtures("kernels")
def test_a_minute_of_chaos(ros_domain: int) -> None:
    # Beside other graphs a node may take longer to start than it may when it has the machine for itself.
    command = [sys.executable, "-m", "chaos", "--minutes", "1", "--seed", "11", "--slack", "4"]
    paths = [str(TESTS), str(TESTS / "graph"), str(TESTS.parent)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    command += ["--domain", str(ros_domain)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    announced = re.search(r"(\d+) announced", done.stdout)
    assert announced is not None
    assert int(announced[1]) > 20
    assert "s until back" in done.stdout
