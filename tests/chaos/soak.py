"""Hours without faults: whether memory, descriptors, threads or files grow."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.stats import theilslopes

from chaos.resources import folder_bytes
from chaos.running_site import RunningSite
from ltm_core.types import Float64Array
from ltm_ros.bench.process_usage import Usage, shared_memory_objects, usage_of

EVERY_S = 30.0
SETTLED_AFTER = 1 / 3
"""Share of the time after which growth is taken: before it, caches fill and what is rare happens first."""
SUM = "in sum"
MOST_KB_A_MINUTE = 10.0
JUDGED_MINUTES = 30.0
"""From which on a soak is judged: a shorter one sees caches fill."""
ENDS = 1 / 8
"""Share of the settled samples whose median is taken for the beginning, and for the end."""


@dataclass(frozen=True)
class Growth:
    """Of memory, over the settled part of a soak. kB, and kB a minute.

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


@dataclass
class Soak:
    """Samples of a running site. `seconds`: from the first sample."""

    seconds: list[float] = field(default_factory=list)
    usage: list[dict[str, Usage]] = field(default_factory=list)
    shared_objects: list[int] = field(default_factory=list)
    state_bytes: list[int] = field(default_factory=list)

    def watch(self, site: RunningSite, state: Path, minutes: float, tell: Callable[[str], None]) -> None:
        """Sample every 30 s for so long."""
        begun = time.monotonic()
        while (elapsed := time.monotonic() - begun) <= 60.0 * minutes:
            self.seconds.append(elapsed)
            self.usage.append(usage_of(site.processes()))
            self.shared_objects.append(shared_memory_objects())
            self.state_bytes.append(folder_bytes(state))
            own = sum(one.own for one in self.usage[-1].values())
            private = sum(one.private for one in self.usage[-1].values())
            tell(f"{elapsed:6.0f} s: {len(self.usage[-1])} processes, {own} kB of their own, {private} kB private")
            time.sleep(max(0.0, begun + EVERY_S * len(self.seconds) - time.monotonic()))

    def growth(self) -> dict[str, Growth]:
        """Of the memory of its own (`Usage.own`) of each process that lived through the last two thirds, and in sum."""
        first = int(len(self.seconds) * SETTLED_AFTER)
        minutes = np.array(self.seconds[first:]) / 60.0
        settled = self.usage[first:]
        lasting = sorted(set.intersection(*(set(sample) for sample in settled)))
        series = {label: np.array([sample[label].own for sample in settled], float) for label in lasting}
        series[SUM] = np.sum(list(series.values()), axis=0)
        return {label: Growth.of(minutes, memory) for label, memory in series.items()}

    def missed(self) -> list[str]:
        """What a soak of `JUDGED_MINUTES` or more must not show."""
        if self.seconds[-1] < 60.0 * JUDGED_MINUTES - EVERY_S:
            return []
        slope = self.growth()[SUM].slope
        return [f"memory grows by {slope:.1f} kB a minute in sum"] if slope > MOST_KB_A_MINUTE else []
