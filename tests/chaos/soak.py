"""Hours without faults: whether memory, descriptors, threads or files grow."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from chaos.heartbeats import Heartbeats
from chaos.running_site import RunningSite
from ltm_lab.bench.growth import SUM, Growth, GrowthWatch, Sample, medians, memory_growth
from ltm_ros.runtime.process_memory import MemoryInUse

EVERY_S = 5.0
A_MINUTE = 12
"""Samples of which the median is taken: processes give back once a minute."""
SETTLED_AFTER = 1 / 3
"""Share of the time after which growth is taken: before it, caches fill and what is rare happens first."""
MOST_KB_A_MINUTE = 10.0
JUDGED_MINUTES = 30.0
"""From which on a soak is judged: a shorter one sees caches fill."""


@dataclass(frozen=True)
class InUseGrowth:
    """Of what a process says that objects lie in."""

    heap_kb: Growth
    python_blocks: Growth


@dataclass
class Soak:
    """Samples of a running site."""

    samples: list[Sample] = field(default_factory=list)
    in_use: list[dict[str, MemoryInUse]] = field(default_factory=list)
    """At each sample, what processes have last said."""

    def watch(
        self, site: RunningSite, heartbeats: Heartbeats, state: Path, minutes: float, tell: Callable[[str], None]
    ) -> None:
        """Sample for so long."""
        begun = time.monotonic()
        watch = GrowthWatch(site.processes, state, EVERY_S)
        self.samples = watch.samples
        while time.monotonic() - begun <= 60.0 * minutes:
            watch.sample()
            self.in_use.append(heartbeats.memory_in_use())
            last = self.samples[-1]
            own, private = (sum(getattr(one, what) for one in last.usage.values()) for what in ("own", "private"))
            if len(self.samples) % A_MINUTE == 1:
                tell(f"{last.seconds:6.0f} s: {len(last.usage)} processes, {own} kB of their own, {private} kB private")
            time.sleep(max(0.0, begun + EVERY_S * len(self.samples) - time.monotonic()))

    def growth(self) -> dict[str, Growth]:
        """Of the memory of its own (`Usage.own`) of each process that lived through the last two thirds, and in sum."""
        return memory_growth(self.samples[self._settled :], A_MINUTE)

    def growth_in_use(self) -> dict[str, InUseGrowth]:
        """Likewise, of the processes that say what they use."""
        minutes = np.array([sample.seconds for sample in self.samples[self._settled :]]) / 60.0
        said = self.in_use[self._settled :]

        def of(label: str, what: str, unit: float) -> Growth:
            values = np.array([getattr(one[label], what) / unit for one in said])
            return Growth.of(medians(minutes, A_MINUTE), medians(values, A_MINUTE))

        lasting = sorted(set.intersection(*(set(one) for one in said)))
        return {
            label: InUseGrowth(of(label, "heap_bytes", 1024.0), of(label, "python_blocks", 1.0)) for label in lasting
        }

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
