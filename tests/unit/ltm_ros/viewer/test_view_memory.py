"""The live view's memory, with its server's, after more has been shown than the server keeps."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rerun", reason="the viewer's extra is not installed")

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")]

TESTS = Path(__file__).parents[3]
MOST_MB = 1500

_SHOWS = """
import os, socket
import numpy as np
from scenes.rerun_site import LABELS, STAMP, hills, site
from ltm_core.geometry.camera import Camera
from ltm_lab.bench.process_usage import usage
from ltm_ros.runtime.process_memory import steady_allocation
from ltm_ros.viewer import RerunView

steady_allocation()

def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]

def family(pid):
    threads = f"/proc/{pid}/task"
    children = " ".join(open(f"{threads}/{thread}/children").read() for thread in os.listdir(threads)).split()
    return [pid, *(other for child in children for other in family(int(child)))]

def held_mb():
    return sum(found.pss for pid in family(os.getpid()) if (found := usage(pid))) / 1000

camera = Camera.from_fov(1920, 1080, 60.0)
names = ("north", "east", "south", "west")
view = RerunView("ltm", site(**{name: {} for name in names}), hills(), LABELS, serve=True, web_port=free_port(),
                 grpc_port=free_port())
rng = np.random.default_rng(3)
photo = np.kron(rng.integers(0, 255, (270, 480, 3), np.uint8), np.ones((4, 4, 1), np.uint8))
depth = np.linspace(300, 9000, 1080 * 1920, dtype=np.float32).reshape(1080, 1920)
labels = np.kron(rng.integers(0, 7, (108, 192), np.uint8), np.ones((10, 10), np.uint8))
points, colors = rng.random((15_000, 3), np.float32), rng.integers(0, 255, (15_000, 3), np.uint8)
for second in range(8):
    for name in names:
        stamp = STAMP + second * 10**9
        view.log_image(name, stamp, photo)
        view.log_depth(name, stamp, depth, camera)
        view.log_labels(name, stamp, labels)
        view.log_fusion(name, stamp, depth, depth + 5, depth[::4, ::4])
        view.log_points(name, stamp, points, colors)
print(f"after 8 frames of each camera {held_mb():.0f} MB")
for number in range(9000):
    view.log_points(names[number % 4], STAMP + 10**10 + number * 10**8, points, colors)
    if number % 1000 == 999:
        print(f"after {number * 0.225:.0f} MB of points")
        print(f"{held_mb():.0f}", flush=True)
view.close()
"""


def test_a_server_that_is_full_forgets_what_is_oldest() -> None:
    command = [sys.executable, "-c", _SHOWS]
    environment = os.environ | {"PYTHONPATH": f"{TESTS}:{TESTS.parent}"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    held = [int(line) for line in done.stdout.splitlines() if line.isdigit()]
    assert len(held) == 9
    assert max(held) < MOST_MB, done.stdout
    assert held[-1] - held[-3] < 50, done.stdout
