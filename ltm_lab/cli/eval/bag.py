"""`ltm-lab eval BAG`: scores a recorded run against the truth that was recorded or kept with it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile, writable_folder


def bag(
    bag: Annotated[Path, typer.Argument(help="Bag folder or .mcap file of a run, such as out/demo/recording.")],
    site: Annotated[
        Path | None, typer.Option("--site", help="Site file; default: beside the bag, or a shipped one of its name.")
    ] = None,
    truth: Annotated[
        Path | None, typer.Option("--truth", help="Folder of truth rasters; default: the site file's.")
    ] = None,
    date: Annotated[str | None, typer.Option("--date", help="Of a truth folder with several dates: the bag's.")] = None,
    json_path: JsonFile = None,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report", help="Also draw the figures to this folder, with a page of them.", callback=writable_folder
        ),
    ] = None,
    depth_maps: Annotated[
        list[str] | None,
        typer.Option(
            "--depth-maps",
            metavar="NAME=FOLDER",
            help="Another source of depth: FOLDER/CAMERA/STAMP_NS.npy; depth_maps.yaml in it says kind and unit.",
        ),
    ] = None,
    before: Annotated[
        Path | None, typer.Option("--before", help="For the report: a run of the same cameras at an earlier date.")
    ] = None,
    before_date: Annotated[
        str, typer.Option("--before-date", help="Its date, where the truth folder has several.")
    ] = "before",
    photos: Annotated[
        Path | None, typer.Option("--photos", help="For the report: a folder of real photos to stand beside.")
    ] = None,
) -> None:
    """Score BAG: depth by range for each source, labels, skyline, fuel cells, terrain and latency, in one table."""
    import os
    import platform

    from rich.console import Console

    from ltm_core.base.errors import ConfigError, RecordingError
    from ltm_lab.evaluation.depth.depth_maps_io import DepthMapFolder
    from ltm_lab.evaluation.figures_io import write_figures
    from ltm_lab.evaluation.run_score import DEPTH_SOURCES, score_bag
    from ltm_lab.evaluation.score_tables import as_json, rich_table, tables
    from ltm_ros.recordings.recorded_run import Recorded

    console = Console()
    folders: list[DepthMapFolder] = []
    for given in depth_maps or []:
        name, equals, folder = given.partition("=")
        if not (name and equals and folder):
            raise ConfigError(f"--depth-maps {given!r}: give NAME=FOLDER, such as --depth-maps depth_pro=out/depth_pro")
        if name in DEPTH_SOURCES or any(name == other.name for other in folders):
            raise ConfigError(f"--depth-maps {given!r}: another source is called {name!r}; give this one its own name")
        folders.append(DepthMapFolder.open(name, Path(folder)))
    recorded = Recorded.find(bag, site, truth, date)
    with console.status("scoring"):
        score = score_bag(recorded, folders)
    parts = tables(score)
    nothing = all(part.title == "lacking" for part in parts)
    if not nothing:
        console.print(rich_table(parts, f"{bag} against truth"))
    for part in parts:
        if part.note:
            console.print(f"[bold]{part.title}[/]: {part.note}", highlight=False)
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
        from ltm_lab.evaluation.score_report import ReportInputs, write_eval_report

        earlier = None
        if before is not None:
            earlier = Recorded.find(before, site or recorded.site_path, truth, before_date if date else None)
        with console.status("drawing") as status:
            page = write_eval_report(
                report, recorded, score, ReportInputs(earlier, photos, folders), lambda what: status.update(what)
            )
        console.print(f"report: {page}")
    if nothing:
        raise RecordingError(f"{bag} could not be scored on anything; run the graph on it with `ltm replay --record`")
