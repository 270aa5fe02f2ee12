"""Tables of a run's scores for the report: depth by range, and fuel maps side by side."""

from __future__ import annotations

import math

from ltm_core.scoring.depth import DepthScore
from ltm_ros.demo.report import NOTHING, Table
from ltm_ros.demo.score import SHARED, RunScore

_AGAINST = {"visible surface": "surface", "bare ground": "ground", SHARED: "shared"}


def bin_name(score: DepthScore) -> str:
    """Return the range of a depth score: `100-300 m`."""
    if score.near == 0 and math.isinf(score.far):
        return "all"
    return f"> {score.near:,.0f} m" if math.isinf(score.far) else f"{score.near:,.0f}-{score.far:,.0f} m"


def percent(value: float) -> str:
    """Return a share as text."""
    return f"{100 * value:.1f} %" if math.isfinite(value) else NOTHING


def depth_table(score: RunScore) -> Table | None:
    """Return errors by source and range; None without depth."""
    rows: list[tuple[object, ...]] = []
    for row in score.depth:
        for one in row.scores:
            rows.append(
                (
                    f"{row.source}, {_AGAINST[row.against]}" if one is row.scores[0] else "",
                    bin_name(one),
                    one.pixels,
                    one.rmse,
                    one.mae,
                    one.median,
                    one.bias,
                )
            )
    if not rows:
        return None
    covered = ", ".join(
        f"{row.source} {100 * row.coverage:.1f} %" for row in score.depth if row.against == "visible surface"
    )
    note = (
        "Metres along the optical axis, by true depth, against the visible surface (vegetation included) and bare "
        f"ground. Truth pixels of finite depth that got a depth: {covered}."
    )
    sources = {row.source for row in score.depth}
    if any(row.against == SHARED for row in score.depth):
        note += " Shared: against the surface, on pixels where every source has a depth, so that sources compare."
    if "network" in sources:
        note += " Network: its own depth at the scale that the terrain gave it; published where that fit was sound."
    return Table(
        "depth", ("source, against", "true depth", "pixels", "RMSE m", "MAE m", "median m", "bias m"), rows, note
    )


def fuel_maps_table(score: RunScore) -> Table | None:
    """Return the map beside the prior and the majority vote, on the same cells; None with one map."""
    maps = (("evidence over the prior", score.fuel), ("majority vote", score.fuel_vote), ("prior", score.fuel_prior))
    rows = [(name, one.seen, one.right, percent(one.right / max(1, one.seen))) for name, one in maps if one is not None]
    if len(rows) < 2:
        return None
    note = "Cells that a recorded frame voted in; life form against the true one."
    if (changes := score.fuel_changes) is not None:
        found, false = changes.found, changes.false_flips
        note += (
            f" Of {found.of:,} cells that are no more what the prior says the map has found {found.count:,}, of "
            f"{false.of:,} that are it has changed {false.count:,}."
        )
    return Table("fuel maps", ("map", "cells seen", "right", "share"), rows, note)
