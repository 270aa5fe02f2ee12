"""Keeps the memory of a process that runs for months where it is after its start. Standard library only."""

from __future__ import annotations

import ctypes
import gc
import os

ARENAS = 2
"""Of glibc's malloc, in a process: the main one, and one for all other threads."""

_M_ARENA_MAX = -8


def limit_arenas() -> None:
    """Have glibc's malloc keep at most `ARENAS` heaps; before threads are started.

    Else it gives each thread one of its own, up to eight a core, and what is allocated in one thread and freed in
    another, as messages are, leaves holes in all of them. Where the user has chosen (`MALLOC_ARENA_MAX`,
    `GLIBC_TUNABLES`), and with another C library, nothing is done.
    """
    if os.environ.get("MALLOC_ARENA_MAX") or "malloc.arena_max" in os.environ.get("GLIBC_TUNABLES", ""):
        return
    if (mallopt := getattr(ctypes.CDLL(None), "mallopt", None)) is not None:
        mallopt(_M_ARENA_MAX, ARENAS)


def settle() -> None:
    """Give back what the start has left over; call it when a process has made all that it keeps.

    Imports and compiled kernels leave cycles of objects. Python looks for such among old objects only once a quarter as
    many have been made anew, which takes a node hours: meanwhile what it makes takes fresh memory beside them. What is
    left now stays for good, so later looks leave it out, and are short.
    """
    gc.collect()
    gc.freeze()
    gc.collect()  # so that the rule of the quarter counts from here
    if (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)) is not None:
        trim(ctypes.c_size_t(0))
