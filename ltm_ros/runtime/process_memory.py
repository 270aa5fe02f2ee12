"""Keep the memory of a long-running process constant. Uses only the standard library."""

import ctypes
import gc
import os
from functools import cache

ARENAS = 2
"""Number of arenas of glibc's malloc: the main one, and one for all other threads."""

TIDY_EVERY_S = 60.0

MAPPED_FROM = 128 << 10
"""Bytes from which a block is mapped separately: glibc's initial value."""

_M_MMAP_THRESHOLD = -3
_M_ARENA_MAX = -8
_PR_SET_THP_DISABLE = 41


def steady_allocation() -> None:
    """Configure memory allocation so that freed memory is returned; call it before threads are started.

    glibc's malloc gives each thread its own heap, and messages that one thread allocates and another frees fragment all
    of them. NumPy requests huge pages (2 MB) for arrays of 4 MB, which the kernel also applies to their remains; they
    saved no processor time (`ltm-lab bench graph`). The user's settings and other C libraries are left unchanged."""
    libc = _libc()
    chosen = os.environ.get("MALLOC_ARENA_MAX") or "malloc.arena_max" in os.environ.get("GLIBC_TUNABLES", "")
    if not chosen and (mallopt := getattr(libc, "mallopt", None)) is not None:
        mallopt(_M_ARENA_MAX, ARENAS)
    if not os.environ.get("NUMPY_MADVISE_HUGEPAGE"):
        libc.prctl(_PR_SET_THP_DISABLE, *(ctypes.c_ulong(number) for number in (1, 0, 0, 0)))


def map_large_blocks() -> None:
    """Map each block of `MAPPED_FROM` bytes or more separately, and return it when freed; for a process that large
    blocks only pass through.

    glibc raises the threshold to the largest block ever freed, up to 32 MB. Messages then go to the heap, whose pages
    small blocks keep. Mapping costs a page fault per 4 kB: too much for processes that create arrays for each frame.
    The user's settings and other C libraries are left unchanged."""
    tuned = "malloc.mmap_threshold" in os.environ.get("GLIBC_TUNABLES", "")
    mallopt = getattr(_libc(), "mallopt", None)
    if mallopt is not None and not tuned and not os.environ.get("MALLOC_MMAP_THRESHOLD_"):
        mallopt(_M_MMAP_THRESHOLD, MAPPED_FROM)


def settle() -> None:
    """Return memory left over from the start; call it when a process has created everything permanent.

    Imports and compiled kernels leave reference cycles. Python searches old objects only after a quarter as many new
    ones, which takes a node hours. The remaining objects are permanent, so later searches skip them and are short."""
    gc.collect()
    gc.freeze()
    gc.collect()  # so that the quarter counts from here
    trim()


def trim() -> None:
    """Return free pages inside the heaps; glibc itself only does so at their ends. Takes milliseconds, and pages that
    are needed again cost as much: not for each frame."""
    if (malloc_trim := getattr(_libc(), "malloc_trim", None)) is not None:
        malloc_trim(ctypes.c_size_t(0))


@cache
def _libc() -> ctypes.CDLL:
    """Open the C library once: each `CDLL` creates a class of twenty blocks in a cycle, collected only
    minutes later."""
    return ctypes.CDLL(None)


class Trimming:
    """Collects cycles among all objects since the start, and trims, every `TIDY_EVERY_S`: before small permanent blocks
    fill the gaps of large ones. Python itself searches old objects only after hours. `now_s`: a steady clock."""

    def __init__(self, now_s: float) -> None:
        self._tidied = now_s

    def look(self, now_s: float) -> None:
        if now_s - self._tidied >= TIDY_EVERY_S:
            self._tidied = now_s
            gc.collect()
            trim()
