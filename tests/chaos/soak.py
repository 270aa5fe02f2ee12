"""Hours without faults: whether the memory of processes grows."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import theilslopes

from chaos.running_site import RunningSite
from ltm_core.base.types import Float64Array
from ltm_lab.bench.process_usage import Usage, usage_of

EVERY_S = 5.0
A_MINUTE = 12
"""Samples of which the median is taken: processes give back once a minute."""
SETTLED_AFTER = 1 / 3
"""Share of the time after which growth is taken: before it, caches fill and what is rare happens first."""
MOST_KB_A_MINUTE = 10.0
JUDGED_MINUTES = 30.0
"""From which on a soak is judged: a shorter one sees caches fill."""

SUM = "in sum"
ENDS = 1 / 8
"""Share of the samples whose median is the memory at the beginning, and at the end."""


@dataclass(frozen=True)
class Growth:
    """Growth of memory: `slope` and its 95 % interval in kB per minute (Theil and Sen), the rest in kB.

    The slope hardly shows a single step. `grown`, from the median of the first samples to that of the last, includes
    steps, and `largest_step` between two samples shows how much of it came at once.
    """

    slope: float
    low: float
    high: float
    grown: float
    largest_step: float

    @classmethod
    def of(cls, minutes: Float64Array, memory: Float64Array) -> Growth:
        """Fit a series of two or more samples, (N,) each."""
        slope, _, low, high = theilslopes(memory, minutes)
        end = max(1, round(len(memory) * ENDS))
        grown = np.median(memory[-end:]) - np.median(memory[:end])
        return cls(float(slope), float(low), float(high), float(grown), float(np.diff(memory).max()))


@dataclass(frozen=True)
class Sample:
    """What processes use, by label, and when, in seconds from the first sample."""

    seconds: float
    usage: dict[str, Usage]


def medians(values: Float64Array, size: int) -> Float64Array:
    """Return the medians of each `size` values; the rest at the end of a longer series is left out.

    The memory of a process rises and falls by megabytes between the moments, a minute apart, at which it gives back:
    two samples a minute would show that beat and not the growth.
    """
    count = len(values) // size * size if len(values) >= size else len(values)
    return np.median(values[:count].reshape(-1, min(size, count)), axis=1)


def memory_growth(samples: list[Sample], size: int) -> dict[str, Growth]:
    """Return the growth of `Usage.own` of each process present in all samples, by label, and in `SUM`.

    It is fitted to the medians of each `size` samples.
    """
    minutes = np.array([sample.seconds for sample in samples]) / 60.0
    lasting = sorted(set.intersection(*(set(sample.usage) for sample in samples)))
    series = {label: np.array([sample.usage[label].own for sample in samples], float) for label in lasting}
    series[SUM] = np.sum(list(series.values()), axis=0)
    return {label: Growth.of(medians(minutes, size), medians(memory, size)) for label, memory in series.items()}


@dataclass
class Soak:
    """Samples of a running site."""

    samples: list[Sample] = field(default_factory=list)

    def watch(self, site: RunningSite, minutes: float, tell: Callable[[str], None]) -> None:
        """Sample for so long."""
        begun = time.monotonic()
        while time.monotonic() - begun <= 60.0 * minutes:
            self.samples.append(Sample(time.monotonic() - begun, usage_of(site.processes())))
            last = self.samples[-1]
            own, private = (sum(getattr(one, what) for one in last.usage.values()) for what in ("own", "private"))
            if len(self.samples) % A_MINUTE == 1:
                tell(f"{last.seconds:6.0f} s: {len(last.usage)} processes, {own} kB of their own, {private} kB private")
            time.sleep(max(0.0, begun + EVERY_S * len(self.samples) - time.monotonic()))

    def growth(self) -> dict[str, Growth]:
        """Of the memory of its own (`Usage.own`) of each process that lived through the last two thirds, and in sum."""
        return memory_growth(self.samples[self._settled :], A_MINUTE)

    @property
    def _settled(self) -> int:
        """Index of the first sample that counts."""
        return int(len(self.samples) * SETTLED_AFTER)

    def missed(self) -> list[str]:
        """What a soak of `JUDGED_MINUTES` or more must not show."""
        if self.samples[-1].seconds < 60.0 * JUDGED_MINUTES - EVERY_S:
            return []
        slope = self.growth()[SUM].slope
        return [f"memory grows by {slope:.1f} kB a minute in sum"] if slope > MOST_KB_A_MINUTE else []
