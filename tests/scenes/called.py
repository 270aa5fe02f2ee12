"""Call what only kernels call."""

from collections.abc import Callable
from functools import cache
from typing import Any

from numba import njit


@cache
def called(helper: Callable[..., Any]) -> Any:
    """Return a kernel that calls a helper of kernels (`ltm_core.base.kernels.helper`) with its own arguments."""
    return njit(lambda *given: helper(*given))
