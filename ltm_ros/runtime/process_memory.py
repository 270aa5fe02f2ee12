"""Keeps the memory of a process that runs for months where it is after its start. Standard library only."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

ARENAS = 2
"""Of glibc's malloc, in a process: the main one, and one for all other threads."""

TRIM_EVERY_S = 60.0
TIDY_EVERY_S = 600.0

MAPPED_FROM = 128 << 10
"""Bytes from which a block is mapped by itself where large blocks pass through: glibc's own value at first."""

STRINGS = 1 << 18
"""Enough for Python to make the table of a process of ours anew more than once: it has interned some 30,000."""

_M_MMAP_THRESHOLD = -3
_M_ARENA_MAX = -8
_PR_SET_THP_DISABLE = 41


def steady_allocation() -> None:
    """Have memory be taken and given back as the process asks for it; call it before threads are started.

    Two things else add megabytes hours later. glibc's malloc gives each thread a heap of its own, up to eight a core,
    and what one thread allocates and another frees, as messages are, leaves holes in all of them. And NumPy asks for
    huge pages (2 MB) where arrays of 4 MB lie, so the kernel makes them of what is left of such arrays in the heap,
    whenever it comes by. They saved no processor time (`ltm-lab bench graph`). Where the user has chosen
    (`MALLOC_ARENA_MAX`, `GLIBC_TUNABLES`, `NUMPY_MADVISE_HUGEPAGE`), and with another C library, nothing is done.
    """
    libc = _libc()
    chosen = os.environ.get("MALLOC_ARENA_MAX") or "malloc.arena_max" in os.environ.get("GLIBC_TUNABLES", "")
    if not chosen and (mallopt := getattr(libc, "mallopt", None)) is not None:
        mallopt(_M_ARENA_MAX, ARENAS)
    if not os.environ.get("NUMPY_MADVISE_HUGEPAGE"):
        libc.prctl(_PR_SET_THP_DISABLE, *(ctypes.c_ulong(number) for number in (1, 0, 0, 0)))


def map_large_blocks() -> None:
    """Have a block of `MAPPED_FROM` bytes or more be mapped by itself, and given back when it is freed; call it in a
    process that large blocks only pass through.

    glibc takes the largest block that was ever freed for the size from which on it maps, up to 32 MB. Messages then lie
    in the heap, which grows to the most that ever waited, and what is small and stays keeps its pages there. Mapping
    costs a page fault for each 4 kB: too much for those who make arrays of each frame. Where the user has chosen
    (`MALLOC_MMAP_THRESHOLD_`, `GLIBC_TUNABLES`), and with another C library, nothing is done.
    """
    tuned = "malloc.mmap_threshold" in os.environ.get("GLIBC_TUNABLES", "")
    mallopt = getattr(_libc(), "mallopt", None)
    if mallopt is not None and not tuned and not os.environ.get("MALLOC_MMAP_THRESHOLD_"):
        mallopt(_M_MMAP_THRESHOLD, MAPPED_FROM)


def settle() -> None:
    """Give back what the start has left over; call it when a process has made all that it keeps.

    Imports and compiled kernels leave cycles of objects. Python looks for such among old objects only once a quarter as
    many have been made anew, which takes a node hours: meanwhile what it makes takes fresh memory beside them. What is
    left now stays for good, so later looks leave it out, and are short.

    So with the table of interned strings: Python makes it anew, three times as large as it is in use, once enough have
    come and gone, each name of a file that is read among them: 2 MB at once, half an hour later. Now it is done, and
    the place where the former one lay is there for the next. Not in Python 3.12, where interned strings never go.
    """
    gc.collect()
    gc.freeze()
    gc.collect()  # so that the rule of the quarter counts from here
    trim()
    for number in range(0 if sys.version_info[:2] == (3, 12) else STRINGS):
        sys.intern(f"comes and goes {number}")


def trim() -> None:
    """Give pages of the heaps back in which nothing lies, between others too; glibc itself only does so at their ends.
    It takes milliseconds, and what is needed again costs as much: not for each frame."""
    if (malloc_trim := getattr(_libc(), "malloc_trim", None)) is not None:
        malloc_trim(ctypes.c_size_t(0))


class MemoryInUse(NamedTuple):
    """Of this process: what objects lie in. What it holds besides are holes of the heaps, which are used again."""

    heap_bytes: int | None
    """Of the C library's allocator, mapped blocks among them; None where it does not tell (glibc before 2.33)."""
    python_blocks: int
    """Of Python's allocator for objects of up to 512 bytes."""


def memory_in_use() -> MemoryInUse:
    """As of now, within a tenth of a millisecond."""
    blocks = sys.getallocatedblocks()
    mallinfo = getattr(_libc(), "mallinfo2", None)
    if mallinfo is None:
        return MemoryInUse(None, blocks)
    mallinfo.restype = _MallInfo
    found = mallinfo()
    return MemoryInUse(int(found.uordblks) + int(found.hblkhd), blocks)


@cache
def _libc() -> ctypes.CDLL:
    """Opened once: each `CDLL` makes a class of its own, twenty blocks in a cycle, which Python looks for only minutes
    later; a report came each second."""
    return ctypes.CDLL(None)


class _MallInfo(ctypes.Structure):
    """`struct mallinfo2` of glibc's malloc.h."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in ("arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks")
    ] + [("keepcost", ctypes.c_size_t)]


def tidy() -> None:
    """Have Python look for cycles among all that came since the start, give up the tuples, lists and numbers that it
    keeps to use again, and `trim`. By itself it looks at old objects hours later; what it keeps fills as long."""
    gc.collect()
    trim()


class Trimming:
    """Calls `trim` every `TRIM_EVERY_S`, before small things that stay come to lie in what large ones have left, and
    `tidy` instead every `TIDY_EVERY_S`. `now_s`: a steady clock; `trim`, `tidy`: for tests.
    """

    def __init__(self, now_s: float, trim: Callable[[], None] = trim, tidy: Callable[[], None] = tidy) -> None:
        self._trimmed = self._tidied = now_s
        self._trim, self._tidy = trim, tidy

    def look(self, now_s: float) -> None:
        if now_s - self._tidied >= TIDY_EVERY_S:
            self._tidied = self._trimmed = now_s
            self._tidy()
        elif now_s - self._trimmed >= TRIM_EVERY_S:
            self._trimmed = now_s
            self._trim()
