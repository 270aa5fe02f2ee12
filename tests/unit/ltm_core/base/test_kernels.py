import threading

import numpy as np
import pytest
from numba import config, njit
from numba.core import caching

from ltm_core.base import kernels


@pytest.mark.parametrize(("count", "least"), [(0, 1), (1, 1), (7, 1), (100, 16), (100, 200), (5000, 2)])
@pytest.mark.parametrize("threads", [1, 3])
def test_each_index_is_in_one_part(monkeypatch: pytest.MonkeyPatch, threads: int, count: int, least: int) -> None:
    monkeypatch.setitem(kernels._threads, "count", threads)
    lock, done = threading.Lock(), list[tuple[int, int]]()

    def work(first: int, end: int) -> None:
        with lock:
            done.append((first, end))

    kernels.in_parallel(work, count, least)
    assert [index for first, end in sorted(done) for index in range(first, end)] == list(range(count))
    assert all(end - first >= least for first, end in sorted(done)[:-1])


def test_an_error_in_a_part_reaches_the_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(kernels._threads, "count", 2)
    with pytest.raises(ZeroDivisionError):
        kernels.in_parallel(lambda first, _: 1 // (first - first), 40)


def _doubled(x: float) -> float:
    return 2.0 * x


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_functions_of_a_user_are_loaded_as_numba_loads_them() -> None:
    own, ours = njit(cache=True)(_doubled), kernels.kernel()(_doubled)
    assert own._cache.load_overload.__module__ == caching.__name__
    assert kernels._ByModule not in own._cache._impl_class._locator_classes
    assert ours._cache.load_overload.__module__ == kernels.__name__
    assert own(np.float64(2.0)) == ours(np.float64(2.0)) == 4.0
