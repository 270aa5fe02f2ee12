"""Table of the messages that each node received, sent and dropped."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ltm_ros.runtime.node_summary import NodeRow


def node_rows(summaries: Mapping[str, Mapping[str, str]]) -> list[NodeRow]:
    """One row a node, by name, from the key -> value texts of their diagnostics."""
    return [NodeRow.of(name, dict(summary)) for name, summary in sorted(summaries.items())]


def print_nodes(console: Console, rows: Sequence[NodeRow]) -> None:
    """Messages in and out, drops by cause with the first of each in words, and latency from the moment a frame was
    taken."""
    table = Table(title="nodes: frames and latency", title_justify="left")
    table.add_column("node", no_wrap=True)
    for name in ("in", "out", "drops", "p50 ms", "p95 ms", "work ms"):
        table.add_column(name, justify="right", no_wrap=True)
    if any(row.causes for row in rows):
        table.add_column("why dropped")
    for row in rows:
        times = (row.latency_p50_ms, row.latency_p95_ms, row.work_p50_ms)
        shown = ["" if math.isnan(t) else f"{t:.0f}" for t in times]
        drops = f"[red]{row.dropped}[/red]" if row.dropped else "0"
        causes = [row.causes] if row.causes else []
        table.add_row(_short(row), str(row.received), str(row.published), drops, *shown, *causes)
    console.print(table)
    for row in rows:
        for reason in row.reasons:
            console.print(f"[red]{escape(_short(row))}[/red] dropped by {escape(reason)}", highlight=False)
    console.print("in, out: frames; p50, p95: latency since the frame was taken; work: the node's own time, median")


def _short(row: NodeRow) -> str:
    return "/".join(row.node.split("/")[2:]) or row.node
