"""Ratios between tracers and growth with raster size, from measured costs: the rows of `ltm-lab bench trace --json`."""

from __future__ import annotations

from typing import Any

import numpy as np

from ltm_lab.bench.peers import PEERS
from ltm_lab.bench.tracing import OURS, Measured, Scene


def rows(results: list[Measured], scenes: list[Scene]) -> list[dict[str, Any]]:
    """One row a size and scene.

    Keys: size, scene, pixels, `ours_{warm,cold,still}_{cpu,wall}_ms`, `<peer>_{cpu,wall}_ms`,
    `ratio_<peer>_{warm,cold}` (the peer's processor time over ours), `<tracer>_setup_cpu_ms`, `<tracer>_memory_mb`.
    What was not measured is null.
    """
    by = {(m.size, m.tracer): m for m in results}
    found = []
    for size in sorted({m.size for m in results}):
        for scene in scenes:
            row: dict[str, Any] = {"size": size, "scene": scene.name, "pixels": scene.width * scene.height}
            ours = by.get((size, OURS))
            for state in ("warm", "cold", "still"):
                cost = ours.frames[scene.name][state] if ours else None
                row[f"ours_{state}_cpu_ms"] = cost and cost.cpu_ms
                row[f"ours_{state}_wall_ms"] = cost and cost.wall_ms
            for name in (OURS, *(p.name for p in PEERS)):
                measured = by.get((size, name))
                row[f"{name}_setup_cpu_ms"] = measured and measured.setup.cpu_ms
                row[f"{name}_memory_mb"] = measured and measured.memory_mb
                if name == OURS:
                    continue
                cost = measured.frames[scene.name][""] if measured else None
                row[f"{name}_cpu_ms"] = cost and cost.cpu_ms
                row[f"{name}_wall_ms"] = cost and cost.wall_ms
                for state in ("warm", "cold"):
                    own = row[f"ours_{state}_cpu_ms"]
                    row[f"ratio_{name}_{state}"] = cost.cpu_ms / own if cost and own else None
            found.append(row)
    return found


def growth(table: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Log-log slopes by tracer: 1 is proportional, 0 is independent.

    `frame` and `setup` time and `memory` with the DEM's area (1080p, 60 degrees; needs two sizes), and `pixels`: frame
    time with the number of pixels (largest size).
    """
    found: dict[str, dict[str, float]] = {}
    for name in (OURS, *(p.name for p in PEERS)):
        frame = f"{name}_warm_cpu_ms" if name == OURS else f"{name}_cpu_ms"
        wide = [r for r in table if r["scene"] == "1080p 60 deg"]
        slopes = {
            "frame": _slope(wide, "size", frame, 2.0),
            "setup": _slope(wide, "size", f"{name}_setup_cpu_ms", 2.0),
            "memory": _slope(wide, "size", f"{name}_memory_mb", 2.0),
        }
        sizes = [r["size"] for r in table if r[frame]]
        largest = [r for r in table if sizes and r["size"] == max(sizes) and r["scene"].endswith("60 deg")]
        slopes["pixels"] = _slope(largest, "pixels", frame, 1.0)
        found[name] = {key: value for key, value in slopes.items() if value is not None}
    return {name: slopes for name, slopes in found.items() if slopes}


def _slope(table: list[dict[str, Any]], x: str, y: str, power: float) -> float | None:
    """Slope of log y against log x^power."""
    points = [(r[x] ** power, r[y]) for r in table if r[y] and r[y] > 0]
    if len({p for p, _ in points}) < 2:
        return None
    logs = np.log(np.array(points, np.float64))
    return float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0])
