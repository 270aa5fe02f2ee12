"""Summary of what a node reported at the end of a run, from its diagnostics."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class NodeRow:
    """What a node reported at the end; latencies from the moment a frame was taken, NaN where it has none."""

    node: str
    received: int
    published: int
    dropped: int
    latency_p50_ms: float = math.nan
    latency_p95_ms: float = math.nan
    work_p50_ms: float = math.nan
    causes: str = ""
    """Why messages were dropped: `overload 2, pose 1`."""
    reasons: tuple[str, ...] = ()
    """What was said of the first message that was dropped by each cause, after its name."""

    @classmethod
    def of(cls, node: str, summary: dict[str, str]) -> NodeRow:
        """From the key -> value texts of a node's `/diagnostics` status."""
        causes = {key.removeprefix("dropped."): value for key, value in summary.items() if key.startswith("dropped.")}
        return cls(
            node,
            int(summary.get("frames_in", 0)),
            int(summary.get("frames_out", 0)),
            int(summary.get("dropped", 0)),
            float(summary.get("latency_p50_ms", math.nan)),
            float(summary.get("latency_p95_ms", math.nan)),
            float(summary.get("work_p50_ms", math.nan)),
            ", ".join(f"{cause} {count}" for cause, count in causes.items()),
            tuple(f"{key.removeprefix('reason.')}: {why}" for key, why in summary.items() if key.startswith("reason.")),
        )
