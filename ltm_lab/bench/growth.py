"""Whether what processes hold grows while they work: samples over a run, and what is fitted to them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from scipy.stats import theilslopes

from ltm_core.base.types import Float64Array
from ltm_lab.bench.process_usage import Usage, shared_memory_objects, usage_of

SUM = "in sum"
ENDS = 1 / 8
"""Share of the samples whose median is taken for the beginning, and for the end."""


@dataclass(frozen=True)
class Growth:
    """Of memory, kB, and kB a minute.

    `slope` with the bounds of its 95 % interval (Theil and Sen) hardly sees a single step, wherever it is. `grown`,
    from the median of the first samples to that of the last, sees all of them, and `largest_step`, between two samples,
    says how much of it came at once.
    """

    slope: float
    low: float
    high: float
    grown: float
    largest_step: float

    @classmethod
    def of(cls, minutes: Float64Array, memory: Float64Array) -> Growth:
        """`minutes`, `memory`: (N,), two samples or more."""
        slope, _, low, high = theilslopes(memory, minutes)
        end = max(1, round(len(memory) * ENDS))
        grown = np.median(memory[-end:]) - np.median(memory[:end])
        return cls(float(slope), float(low), float(high), float(grown), float(np.diff(memory).max()))


@dataclass(frozen=True)
class Sample:
    """`seconds`: since the first. `kept_bytes`: of files."""

    seconds: float
    usage: dict[str, Usage]
    shared_objects: int
    kept_bytes: int


def folder_bytes(folder: Path) -> int:
    """Of all files below, as far as they are there."""
    total = 0
    for path in folder.rglob("*"):
        try:
            total += path.stat().st_size if path.is_file() else 0
        except OSError:
            continue
    return total


class GrowthWatch:
    """Samples processes and a folder on a thread of its own, from entering to leaving.

    Args:
        processes: ids by label, as known now.
        kept: where files are kept.
        every_s: seconds between samples.
    """

    def __init__(self, processes: Callable[[], Mapping[str, int]], kept: Path, every_s: float) -> None:
        self.samples: list[Sample] = []
        self._processes, self._kept, self._every_s = processes, kept, every_s
        self._begun = time.monotonic()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="growth", daemon=True)

    def __enter__(self) -> Self:
        self.sample()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._thread.join()
        self.sample()

    def sample(self) -> None:
        usage = usage_of(self._processes())
        seconds = time.monotonic() - self._begun
        self.samples.append(Sample(seconds, usage, shared_memory_objects(), folder_bytes(self._kept)))

    def _run(self) -> None:
        while not self._stopping.wait(self._every_s):
            self.sample()


def medians(values: Float64Array, size: int) -> Float64Array:
    """Medians of each `size` values; what is left at the end of a longer series is left out.

    What a process holds rises and falls by megabytes between the moments, a minute apart, at which it gives back: two
    samples a minute see that beat, and not what grows.
    """
    count = len(values) // size * size if len(values) >= size else len(values)
    return np.median(values[:count].reshape(-1, min(size, count)), axis=1)


def memory_growth(samples: list[Sample], size: int = 1) -> dict[str, Growth]:
    """Of what each process that lived through all samples has asked for (`Usage.own`), by label and in `SUM`; of the
    medians of each `size` samples."""
    minutes = np.array([sample.seconds for sample in samples]) / 60.0
    lasting = sorted(set.intersection(*(set(sample.usage) for sample in samples)))
    series = {label: np.array([sample.usage[label].own for sample in samples], float) for label in lasting}
    series[SUM] = np.sum(list(series.values()), axis=0)
    return {label: Growth.of(medians(minutes, size), medians(memory, size)) for label, memory in series.items()}


@dataclass(frozen=True)
class HeldMore:
    """By how much more is held at the end of a run than at its middle, when caches are full."""

    memory: dict[str, Growth]
    descriptors: int
    threads: int
    shared_objects: int
    """Of Fast DDS in /dev/shm, of all programs of the machine."""
    kept_bytes: int
    """Of files."""

    @classmethod
    def of(cls, samples: list[Sample]) -> HeldMore:
        """Two samples or more."""
        middle = samples[-1].seconds / 2
        late = [sample for sample in samples if sample.seconds >= middle]
        late = late if len(late) > 1 else samples[-2:]
        first, last = late[0], late[-1]

        def total(sample: Sample, what: str) -> int:
            return sum(getattr(one, what) for one in sample.usage.values())

        return cls(
            memory_growth(late),
            total(last, "descriptors") - total(first, "descriptors"),
            total(last, "threads") - total(first, "threads"),
            last.shared_objects - first.shared_objects,
            last.kept_bytes - first.kept_bytes,
        )
