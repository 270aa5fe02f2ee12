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
from ltm_ros.bench.process_usage import Usage, shared_memory_objects, usage_of

EVERY_S = 30.0
SETTLED_AFTER = 1 / 3
"""Share of the time after which slopes are taken: before it, caches fill and what is rare happens first."""
SUM = "in sum"


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
            total = sum(one.private for one in self.usage[-1].values())
            tell(f"{elapsed:6.0f} s: {len(self.usage[-1])} processes, {total} kB of private memory")
            time.sleep(max(0.0, begun + EVERY_S * len(self.seconds) - time.monotonic()))

    def slopes(self) -> dict[str, tuple[float, float, float]]:
        """kB of private memory a minute by process and in sum, with the bounds of its 95 % interval (Theil and Sen);
        over the last two thirds, of processes that lived through them."""
        first = int(len(self.seconds) * SETTLED_AFTER)
        minutes = np.array(self.seconds[first:]) / 60.0
        settled = self.usage[first:]
        lasting = sorted(set.intersection(*(set(sample) for sample in settled)))
        series = {label: np.array([sample[label].private for sample in settled], float) for label in lasting}
        series[SUM] = np.sum(list(series.values()), axis=0)
        found = {}
        for label, private in series.items():
            slope, _, low, high = theilslopes(private, minutes)
            found[label] = float(slope), float(low), float(high)
        return found
