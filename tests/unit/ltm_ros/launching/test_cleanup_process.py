"""The process that cleans up after a killed runner, from the runner's side, without ROS."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

from scenes.waiting import wait_for

RUNNER = """
import os, signal, subprocess, sys, time
from ltm_ros.launching.cleanup_process import CleanupProcess

class LastStarted(subprocess.Popen):
    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        os.kill(os.getpid(), signal.SIGKILL)

subprocess.Popen = LastStarted
cleanup = CleanupProcess(lambda: os.environ, print)
cleanup.folder(sys.argv[1], exists=True)
cleanup.start()
time.sleep(60)
"""


def test_a_runner_that_is_killed_as_soon_as_it_has_one_has_told_it_all(tmp_path: Path) -> None:
    left = tmp_path / "left"
    left.mkdir()
    runner = subprocess.run([sys.executable, "-c", RUNNER, str(left)], timeout=60)
    assert runner.returncode == -signal.SIGKILL
    wait_for(lambda: not left.exists(), "the end of what is left")
