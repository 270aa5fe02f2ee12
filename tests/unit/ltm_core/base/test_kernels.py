import threading

import pytest

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
