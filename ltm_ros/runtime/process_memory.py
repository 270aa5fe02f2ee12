"""Keeps the memory of a process that runs for months where it is after its start. Standard library only."""

from __future__ import annotations

import ctypes
import gc
import os
from collections.abc import Callable

ARENAS = 2
"""Of glibc's malloc, in a process: the main one, and one for all other threads."""

TRIM_EVERY_S = 600.0

_M_ARENA_MAX = -8
_PR_SET_THP_DISABLE = 41


def steady_allocation() -> None:
    """Have memory be taken and given back as the process asks for it; call it before threads are started.

    Two things else add megabytes hours later. glibc's malloc gives each thread a heap of its own, up to eight a core,
    and what one thread allocates and another frees, as messages are, leaves holes in all of them. And NumPy asks for
    huge pages (2 MB) where arrays of 4 MB lie, so the kernel makes them of what is left of such arrays in the heap,
    whenever it comes by. They saved no processor time (`ltm bench graph`, 1080p: 185 and 181 ms a frame without, 189
    and 198 with). Where the user has chosen (`MALLOC_ARENA_MAX`, `GLIBC_TUNABLES`, `NUMPY_MADVISE_HUGEPAGE`), and with
    another C library, nothing is done.
    """
    libc = ctypes.CDLL(None)
    chosen = os.environ.get("MALLOC_ARENA_MAX") or "malloc.arena_max" in os.environ.get("GLIBC_TUNABLES", "")
    if not chosen and (mallopt := getattr(libc, "mallopt", None)) is not None:
        mallopt(_M_ARENA_MAX, ARENAS)
    if not os.environ.get("NUMPY_MADVISE_HUGEPAGE"):
        libc.prctl(_PR_SET_THP_DISABLE, *(ctypes.c_ulong(number) for number in (1, 0, 0, 0)))


def settle() -> None:
    """Give back what the start has left over; call it when a process has made all that it keeps.

    Imports and compiled kernels leave cycles of objects. Python looks for such among old objects only once a quarter as
    many have been made anew, which takes a node hours: meanwhile what it makes takes fresh memory beside them. What is
    left now stays for good, so later looks leave it out, and are short.
    """
    gc.collect()
    gc.freeze()
    gc.collect()  # so that the rule of the quarter counts from here
    trim()


def trim() -> None:
    """Give pages of the heaps back in which nothing lies, between others too; glibc itself only does so at their ends.
    It takes milliseconds, and what is needed again costs as much: not for each frame."""
    if (malloc_trim := getattr(ctypes.CDLL(None), "malloc_trim", None)) is not None:
        malloc_trim(ctypes.c_size_t(0))


class Trimming:
    """Calls `trim` every `TRIM_EVERY_S`, so that holes do not add up. `now_s`: a steady clock; `act`: for tests."""

    def __init__(self, now_s: float, act: Callable[[], None] = trim) -> None:
        self._last, self._act = now_s, act

    def look(self, now_s: float) -> None:
        if now_s - self._last >= TRIM_EVERY_S:
            self._last = now_s
            self._act()
