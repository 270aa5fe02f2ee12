from __future__ import annotations

import os
import subprocess
import sys

from scenes.waiting import wait_for

from ltm_ros.tower.machine import KEPT_S, ProcessMemory, processes_of


def test_memory_of_processes_by_name_and_not_looked_at_at_each_question() -> None:
    command = [sys.executable, "-c", "print(flush=True); input()", "ltm_ros.launching.supervised"]
    north = ["ltm_ros.nodes.depth", "--ros-args", "-r", "__ns:=/ridge/north"]
    children = [
        subprocess.Popen([*command, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        for words in (["ltm_ros.nodes.fuel_map"], north)
    ]
    try:
        for child in children:  # until its interpreter is up, it holds next to nothing
            assert child.stdout is not None
            child.stdout.readline()
        wait_for(lambda: len(processes_of(os.getpid())) == 2, "both")
        memory = ProcessMemory(os.getpid())
        used = memory.used(100.0)
        assert set(used) == {"fuel_map", "north/depth"}
        assert all(1e6 < size < 1e8 for size in used.values()), used
    finally:
        for child in children:
            child.communicate(b"\n")
    assert memory.used(100.0 + KEPT_S) == used, "looked at once"
    assert memory.used(100.5 + KEPT_S) == {}
