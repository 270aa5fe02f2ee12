"""What the soak measures, and the slope that it fits."""

from __future__ import annotations

import mmap
import os
import threading
from pathlib import Path

import numpy as np
from chaos.resources import folder_bytes, waited_s
from chaos.soak import SUM, Soak

from ltm_ros.bench.process_usage import Usage, usage

_BYTES = 10_000 * mmap.PAGESIZE


def test_usage_of_this_process(tmp_path: Path) -> None:
    before = usage(os.getpid())
    assert before is not None
    done = threading.Event()
    thread = threading.Thread(target=done.wait)
    thread.start()
    with (tmp_path / "open").open("wb"):
        block = mmap.mmap(-1, _BYTES)  # not from a heap that may have had it already
        block[:: mmap.PAGESIZE] = bytes(_BYTES // mmap.PAGESIZE)
        after = usage(os.getpid())
    done.set()
    thread.join()
    assert after is not None
    assert after.private - before.private > 0.9 * _BYTES / 1024
    assert after.pss - before.pss > 0.9 * _BYTES / 1024
    assert after.descriptors - before.descriptors == 1
    assert after.threads - before.threads == 1
    assert usage(2**22 + 1) is None
    assert waited_s(os.getpid()) > 0
    assert waited_s(2**22 + 1) == 0


def test_bytes_of_a_folder(tmp_path: Path) -> None:
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a" / "one").write_bytes(bytes(7))
    (tmp_path / "a" / "b" / "two").write_bytes(bytes(30))
    assert folder_bytes(tmp_path) == 37


def test_slopes_are_those_of_the_last_two_thirds() -> None:
    """One process fills a cache and then keeps 12 kB a minute, with a leap that is no slope; another stands still."""
    soak = Soak()
    for number in range(91):
        minutes = 0.5 * number
        grows = 5000 + min(900 * minutes, 9000) + 12 * minutes + (4000 if number == 70 else 0)
        soak.seconds.append(60 * minutes)
        soak.usage.append({"grows": Usage(0, round(grows), 9, 3, 0.0), "stays": Usage(0, 700, 9, 3, 0.0)})
    soak.usage[2]["ended early"] = Usage(0, 10**6, 9, 3, 0.0)
    slopes = soak.slopes()
    assert slopes.keys() == {"grows", "stays", SUM}
    slope, low, high = slopes[SUM]
    assert slopes["stays"] == (0.0, 0.0, 0.0)
    np.testing.assert_allclose((slope, slopes["grows"][0]), 12.0, atol=0.2)
    assert low <= slope <= high < 13.0
