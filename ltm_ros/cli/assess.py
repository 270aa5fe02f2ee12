"""`ltm assess`: measure the accuracy of a fuel map from a stratified random sample of its cells."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from ltm_core.site.site_io import load_site
from ltm_core.storage.disk_io import require_files
from ltm_ros.assessment.figures import compute_figures
from ltm_ros.assessment.look_command import learn, look
from ltm_ros.assessment.plan import find_map, read_map_plan, with_map, write_plan
from ltm_ros.cli.output import command_group, print_table
from ltm_ros.fuel_map.source import FuelSource

assess = command_group("Measure the accuracy of a fuel map from a random sample of its cells.")
assess.command()(look)
assess.command()(learn)


@assess.command()
def plan(
    map_: Annotated[Path, Argument(metavar="MAP", help="Fuel map: store (.ltm), its folder, bag, or GeoTIFF.")],
    site: Annotated[Path, Option(help="Site file.")],
    out: Annotated[Path, Option("--out", "-o", help="Folder for the plan.")],
    cells: Annotated[int, Option(min=20, max=5000, help="Number of sampled cells.")] = 300,
    seed: Annotated[int, Option(min=0, help="Seed of the random sample.")] = 1,
) -> None:
    """Draw a stratified random sample of observed cells: by life form, changed cells more densely."""
    path = find_map(map_)
    with FuelSource.open(path, load_site(site)) as source:
        about = write_plan(source, path, site, cells, seed, out)
    widths = about["expected_half_width"]
    rows = [
        (s["name"], f"{s['cells']:,}", str(s["sampled"]), f"{100 * widths[s['name']]:.0f} %") for s in about["strata"]
    ]
    total = sum(s["cells"] for s in about["strata"]), sum(s["sampled"] for s in about["strata"])
    rows.append(("all", f"{total[0]:,}", str(total[1]), f"{100 * widths['overall']:.1f} %"))
    print_table("sample", ("stratum", ">observed cells", ">sampled", ">± (95 %) at 80 % accuracy"), rows)
    typer.echo(f"wrote {out}; next: ltm assess look {out} --recordings FOLDER")


@assess.command()
def report(
    plan_: Annotated[Path, Argument(metavar="PLAN", help="Folder of the plan, written by `ltm assess plan`.")],
    out: Annotated[Path, Option("--out", "-o", help="File of the report; figures go to .json beside it.")],
    recordings: Annotated[list[Path] | None, Option(help="Recording, or folder. Repeatable.", metavar="FOLDER")] = None,
    plots: Annotated[Path | None, Option(help="Field plots: CSV or GeoPackage with lon, lat, life_form, date.")] = None,
    map_: Annotated[Path | None, Option("--map", help="Another map, such as after `learn`; default: PLAN's.")] = None,
) -> None:
    """Write accuracies and areas with 95 % intervals, maps and errors to one HTML page and a JSON file."""
    from ltm_ros.assessment.report import keep_accuracy, write_report  # they need the extra ltm[report]
    from ltm_ros.pages import write_figures

    require_files([out, out.with_suffix(".json")])
    planned = read_map_plan(plan_)
    if map_ is not None:
        path = find_map(map_)
        with FuelSource.open(path, load_site(Path(planned.shown.site))) as source:
            planned = with_map(planned, source, path)
    figures = compute_figures(planned, plots)
    more = write_report(out, planned, figures, recordings or [])
    write_figures(out.with_suffix(".json"), figures.as_json(planned) | more)
    keep_accuracy(planned, figures)
    typer.echo(figures.line(planned))
    typer.echo(f"wrote {out} and {out.with_suffix('.json')}")
