import subprocess
import sys

import pytest

pytest.importorskip("rclpy", reason="nodes need ROS 2 (pip install ltm[ros])")

STOPPED_WITH_ITS_FIRST_THREAD = """
import os, signal, threading
from ltm_ros.runtime.node_process import run_until_stopped

start = threading.Thread.start

def told(self):
    threading.Thread.start = start
    start(self)
    os.kill(os.getpid(), signal.SIGTERM)

threading.Thread.start = told
run_until_stopped("depth", lambda: print("made"))
print("ended in order")
"""


def test_a_stop_that_comes_as_soon_as_it_is_listened_for_ends_in_order() -> None:
    ended = subprocess.run(
        [sys.executable, "-c", STOPPED_WITH_ITS_FIRST_THREAD], capture_output=True, text=True, timeout=120, check=False
    )
    assert (ended.stdout, ended.stderr, ended.returncode) == ("ended in order\n", "", 0)
