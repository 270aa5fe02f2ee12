import os
import subprocess
import sys
from pathlib import Path

import pytest

import ltm_ros

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="glibc's malloc")

_ROOT = Path(ltm_ros.__file__).resolve().parents[1]

_HEAPS = """
import ctypes, re, threading
libc = ctypes.CDLL(None)
libc.malloc.restype = libc.open_memstream.restype = ctypes.c_void_p
everybody = threading.Barrier(12)
def hold():
    assert libc.malloc(5000)  # in each thread, while the others live
    everybody.wait()
threads = [threading.Thread(target=hold) for _ in range(12)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
text, size = ctypes.c_char_p(), ctypes.c_size_t()
stream = ctypes.c_void_p(libc.open_memstream(ctypes.byref(text), ctypes.byref(size)))
libc.malloc_info(0, stream)
libc.fclose(stream)
print(len(re.findall(rb"<heap nr=", text.value)))
"""

_HUGE_PAGES = """
import re
print(re.search(r"^THP_enabled:\\s+(\\d)$", open("/proc/self/status").read(), re.MULTILINE)[1])
"""

_AS_A_SHELL_WOULD = """
import ctypes, os, sys
ctypes.CDLL(None).prctl(41, *(ctypes.c_ulong(0) for _ in range(4)))  # PR_SET_THP_DISABLE
os.execv(sys.executable, [sys.executable, *sys.argv[1:]])
"""
"""Starts Python with the arguments. A test of `ltm run` may have been in this process before, which then has given up
huge pages for itself and all that it starts."""

_CYCLES = """
import gc
gc.disable()
from ltm_ros.runtime.process_memory import settle
class Node:
    made = 0
    def __init__(self):
        Node.made += 1
        self.itself = self
    def __del__(self):
        Node.made -= 1
def leave(count):
    for _ in range(count):
        Node()
keeps = [[n] for n in range(600_000)]
for _ in range(1000):
    Node()
print(Node.made, len(gc.get_objects()) > len(keeps))
settle()
print(Node.made, len(gc.get_objects()) > len(keeps))
gc.enable()
young = [[n] for n in range(100_000)]  # a quarter of what was there before would not be enough
print(gc.get_stats()[2]["collections"] > 2)
"""


_PASSING = """
import ctypes, sys
from ltm_ros.runtime.process_memory import MAPPED_FROM, map_large_blocks
if "map" in sys.argv:
    map_large_blocks()
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096
libc.free(ctypes.c_void_p(libc.malloc(20_000_000)))  # from here on glibc maps only what is larger
before, passing = resident(), []
for _ in range(200):
    for size in (2 * MAPPED_FROM, 5000):
        block = ctypes.c_void_p(libc.malloc(size))
        ctypes.memset(block, 1, size)
        if size > 5000:
            passing.append(block)
[libc.free(block) for block in passing]
print((resident() - before) / (400 * MAPPED_FROM))
"""


def _run(program: str, folder: Path | None = None, *arguments: str, **environment: str) -> str:
    given = {name: value for name, value in os.environ.items() if not name.startswith(("MALLOC_", "GLIBC_", "NUMPY_"))}
    python = [sys.executable, "-S", "-c", _AS_A_SHELL_WOULD]
    command = [*python, "-c", program, *arguments]
    if folder is not None:
        (folder / "says_how_it_is.py").write_text(program)
        told = os.open(os.devnull, os.O_WRONLY)
        command = [*python, "-m", "ltm_ros.launching.supervised", "says_how_it_is"]
        environment |= {"LTM_HEARTBEAT": str(told), "PYTHONPATH": f"{folder}:{_ROOT}"}
        done = subprocess.run(
            command, env=given | environment, capture_output=True, text=True, timeout=60, check=True, pass_fds=(told,)
        )
        os.close(told)
        return done.stdout
    environment |= {"PYTHONPATH": str(_ROOT)}
    return subprocess.run(
        command, env=given | environment, capture_output=True, text=True, timeout=60, check=True
    ).stdout


def test_supervised_process_has_few_heaps(tmp_path: Path) -> None:
    assert int(_run(_HEAPS)) > 4  # what glibc does by itself
    assert int(_run(_HEAPS, tmp_path)) == 2


def test_supervised_process_gets_no_huge_pages(tmp_path: Path) -> None:
    assert _run(_HUGE_PAGES).strip() == "1"
    assert _run(_HUGE_PAGES, tmp_path).strip() == "0"
    assert _run(_HUGE_PAGES, tmp_path, NUMPY_MADVISE_HUGEPAGE="1").strip() == "1"


def test_what_the_start_left_over_is_gone_and_what_stays_is_looked_at_no_more() -> None:
    before, after, looks = _run(_CYCLES).splitlines()
    assert (before, after) == ("1000 True", "0 False")
    assert looks == "True"


def test_large_blocks_that_pass_through_leave_no_holes() -> None:
    assert float(_run(_PASSING)) > 0.8
    assert float(_run(_PASSING, None, "map")) < 0.1
    assert float(_run(_PASSING, None, "map", MALLOC_MMAP_THRESHOLD_=str(1 << 25))) > 0.8
