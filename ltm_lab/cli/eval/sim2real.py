"""`ltm-lab eval sim2real REAL SIM`: measures how far simulated pictures are from real ones."""

from pathlib import Path
from typing import Annotated

import typer

from ltm_lab.options import JsonFile


def sim2real(
    real: Annotated[Path, typer.Argument(help="Folder of real pictures.")],
    simulated: Annotated[Path, typer.Argument(metavar="SIM", help="Folder of simulated pictures.")],
    pairs: Annotated[int, typer.Option(min=2, help="Random pairs for SSIM and LPIPS.")] = 300,
    side: Annotated[int, typer.Option(min=32, help="Pixels of the middle square for SSIM and LPIPS.")] = 256,
    seed: Annotated[int, typer.Option(help="Of the pairs and the intervals.")] = 0,
    json_path: JsonFile = None,
) -> None:
    """SSIM, LPIPS, FID and KID between two folders, each with N, its weights and a 95 % interval."""
    import dataclasses
    import math

    from rich.console import Console

    from ltm_lab.cli.eval.score_table import print_table
    from ltm_lab.evaluation.sim2real.comparison import advice, compare, pictures_below
    from ltm_lab.evaluation.sim2real.distribution import Estimate
    from ltm_ros.pages import write_figures

    console = Console()
    a, b = pictures_below(real), pictures_below(simulated)
    with console.status("reading") as status:
        found, pairing = compare(a, b, pairs, side, seed, lambda what, i, n: status.update(f"{what}: {i} of {n}"))

    def shown(estimate: Estimate | None) -> tuple[str, str]:
        if estimate is None:
            return "", ""
        digits = 1 if abs(estimate.value) >= 10 else 4 if abs(estimate.value) < 0.3 else 3
        return f"{estimate.value:.{digits}f}", f"{estimate.low:.{digits}f} to {estimate.high:.{digits}f}"

    rows = [
        (
            f"{row.name} {'↑' if row.better == 'higher' else '↓'}",
            *shown(row.estimate),
            *shown(row.floor),
            "" if row.paper is None else f"{row.paper:.4f}",
        )
        for row in found
    ]
    columns = ("metric", "sim to real", "95 %", "real to real", "95 %", "paper")
    print_table(console, f"{simulated} beside {real}", columns, rows)
    samples = [f"{row.name} {row.sample}, weights {row.weights}" for row in found]
    notes = [
        "↑: more alike when higher, ↓: when lower. N and weights: " + "; ".join(samples) + ".",
        f"SSIM, LPIPS: mean over {pairing.rule}; middle squares at {side} px; interval: bootstrap over pairs.",
        "FID, KID: middle squares at 299 px; interval: 1.96 standard errors from halves of both sets (a bootstrap "
        "would repeat pictures, which raises both)."
        if len(found) > 2
        else "",
        "Real to real: random pairs of real pictures, and one half of them against the other: what to compare with.",
        "Paper: SSIM 0.3614, LPIPS 0.4437, FID 354.4 on a limited set of pairs that are not aligned; N not stated.",
        advice(len(a), len(b)) or "",
    ]
    for note in filter(None, notes):
        console.print(note, highlight=False)
    if json_path is not None:
        content = {
            "real": str(real), "simulated": str(simulated), "pictures": [len(a), len(b)], "pairing": pairing.rule,
            "pairs": len(pairing.pairs), "side_px": side, "seed": seed, "notes": [n for n in notes if n],
            "metrics": [dataclasses.asdict(row) for row in found],
        }  # fmt: skip
        write_figures(json_path, content)
        console.print(f"figures: {json_path}")
    if any(not math.isfinite(row.estimate.value) for row in found):
        raise typer.Exit(1)
