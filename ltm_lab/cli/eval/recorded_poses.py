"""`ltm-lab eval recorded-poses`: by how much a recording's poses are off the true ones."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile


def recorded_poses(
    bag: Annotated[Path, typer.Argument(help="Recording whose poses are judged.")],
    true: Annotated[Path, typer.Option("--true", help="Recording of the same frames with true poses.")],
    site: Annotated[Path, typer.Option("--site", help="Site file of both.")],
    json_path: JsonFile = None,
) -> None:
    """Errors of a recording's poses against another recording of the same frames, joined by stamp; and whether the
    sigmas that it states are as large (1.48 median |error / sigma| is 1 where they are)."""
    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from ltm_core.site.site_io import load_site
    from ltm_ros.demo.pose_errors import PARTS, recorded_pose_errors
    from ltm_ros.pages.figures_io import write_figures

    found = recorded_pose_errors(bag, true, load_site(site))
    table = Table(
        *("of", "mean", "median |error|", "p90", "largest", "sigma stated", "1.48 median |z|"),
        title=f"{bag}: {len(found.errors)} frames against {true}",
        caption=f"{found.unmatched} without a true pose" if found.unmatched else None,
    )
    result: dict[str, object] = {"bag": str(bag), "true": str(true), "frames": len(found.errors)}
    for name, errors, sigmas in zip(PARTS, found.errors.T, found.sigmas.T, strict=True):
        off = np.abs(errors)
        stated = float(np.median(sigmas)) if np.isfinite(sigmas).all() else None
        spread = 1.48 * float(np.median(off / sigmas)) if stated else None
        row = {
            "mean": float(errors.mean()),
            "median": float(np.median(off)),
            "p90": float(np.quantile(off, 0.9)),
            "largest": float(off.max()),
            "sigma": stated,
            "z": spread,
        }
        result[name] = row
        table.add_row(name, *("none" if value is None else f"{value:.2f}" for value in row.values()))
    Console().print(table)
    if json_path is not None:
        write_figures(json_path, result)
