"""The table of what each node took, sent and dropped."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.table import Table

from ltm_ros.report import NodeRow


def node_rows(summaries: Mapping[str, Mapping[str, str]]) -> list[NodeRow]:
    """One row a node, by name, from the key -> value texts of their diagnostics."""
    return [NodeRow.of(name, dict(summary)) for name, summary in sorted(summaries.items())]


def print_nodes(console: Console, rows: Sequence[NodeRow]) -> None:
    """Messages in and out, drops by cause, and latency from the moment a frame was taken."""
    table = Table(title="nodes", title_justify="left")
    table.add_column("node")
    for name in ("in", "out", "drops", "latency p50 ms", "p95 ms", "work p50 ms"):
        table.add_column(name, justify="right")
    table.add_column("why dropped")
    for row in rows:
        times = (row.latency_p50_ms, row.latency_p95_ms, row.work_p50_ms)
        shown = ["" if math.isnan(t) else f"{t:.0f}" for t in times]
        drops = f"[red]{row.dropped}[/red]" if row.dropped else "0"
        table.add_row(row.node, str(row.received), str(row.published), drops, *shown, row.causes)
    console.print(table)
