"""`ltm-lab eval BAG`: scores a recorded run against the truth that was recorded or kept with it."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from ltm_lab.options import JsonFile, writable_folder


def bag(
    bag: Annotated[Path, Argument(help="Bag folder or .mcap file of a run, such as out/demo/recording.")],
    site: Annotated[
        Path | None, Option("--site", help="Site file; default: beside the bag, or a shipped one of its name.")
    ] = None,
    truth: Annotated[Path | None, Option("--truth", help="Folder of truth rasters; default: the site file's.")] = None,
    date: Annotated[str | None, Option("--date", help="Of a truth folder with several dates: the bag's.")] = None,
    json_path: JsonFile = None,
    report: Annotated[
        Path | None,
        Option("--report", help="Also draw the figures to this folder, with a page of them.", callback=writable_folder),
    ] = None,
) -> None:
    """Score BAG: depth by range for each source, labels, skyline, fuel cells, terrain and latency, in one table."""
    import os
    import platform

    from rich.console import Console

    from ltm_core.base.errors import RecordingError
    from ltm_lab.cli.eval.score_table import print_table
    from ltm_lab.evaluation.dated_run import DatedRun
    from ltm_lab.evaluation.run_score import score_bag
    from ltm_lab.evaluation.score_tables import as_json, shown, tables
    from ltm_ros.pages import write_figures

    console = Console()
    recorded = DatedRun.find(bag, site, truth, date)
    with console.status("scoring"):
        score = score_bag(recorded)
    parts = tables(score)
    nothing = all(part.title == "lacking" for part in parts)
    for part in parts:
        if part.title != "lacking":
            rows = [[shown(value) for value in row] for row in part.rows]
            print_table(console, part.title, part.columns, rows, part.note)
    for reason in score.lacking:
        console.print(f"[yellow]lacking[/] {reason}", highlight=False)
    console.print(
        f"conditions: site {recorded.site_path}, {score.frames} frames with truth, "
        f"network {recorded.site.model}, truth rasters {recorded.truth}; "
        f"{len(os.sched_getaffinity(0))} cores, Python {platform.python_version()}",
        highlight=False,
    )
    if json_path is not None:
        write_figures(json_path, as_json(score))
        console.print(f"figures: {json_path}")
    if report is not None:
        from ltm_lab.evaluation.score_report import write_eval_report

        with console.status("drawing"):
            page = write_eval_report(report, recorded, score)
        console.print(f"report: {page}")
    if nothing:
        raise RecordingError(f"{bag} could not be scored on anything; run the graph on it with `ltm replay --record`")
