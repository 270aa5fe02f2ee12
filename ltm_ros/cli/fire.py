"""`ltm fire`: simulate a fire on the fuel map before and after its update."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import Overwrite, print_table


def fire(
    landscape: Annotated[
        Path,
        typer.Argument(help="Fuel map store (.ltm, with --site), or landscape (LCP, GeoTIFF of 8 bands)."),
    ],
    ignition: Annotated[str, typer.Option("--ignition", help="Ignition point x,y in the landscape's CRS.")],
    wind: Annotated[str, typer.Option("--wind", help="Wind speed in m/s at 10 m, and direction it comes from: 8,45.")],
    moisture: Annotated[
        str | None,
        typer.Option(
            help="Fuel moisture: Scott and Burgan scenario (D2L2), or five values in %: dead 1 h, 10 h, 100 h, "
            "live herbaceous, live woody (6,7,8,60,90)."
        ),
    ] = None,
    hours: Annotated[float, typer.Option(help="Duration of the fire in hours.")] = 6.0,
    site: Annotated[Path | None, typer.Option("--site", help="Site file of a store.")] = None,
    before: Annotated[
        Path | None, typer.Option("--before", help="For a landscape file: the earlier landscape.")
    ] = None,
    since: Annotated[
        str | None, typer.Option("--since", help="For a store: date of the earlier map. Default: the prior map.")
    ] = None,
    ignition_crs: Annotated[
        str | None, typer.Option("--ignition-crs", help="CRS of --ignition, such as EPSG:4326 for degrees.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for report, images, GeoTIFF and KMZ.")] = Path(
        "out/fire"
    ),
    overwrite: Overwrite = False,
) -> None:
    """Simulate a fire on the prior and on the updated map, and show the difference. This is no forecast."""
    from rich.console import Console

    from ltm_core.base.number_text import difference, number
    from ltm_core.fire.pyretechnics import interpreter
    from ltm_core.fire.scenario import FireScenario, Moisture, Wind, ignition_cell
    from ltm_core.storage.disk_io import require_files
    from ltm_ros.fire.before_after import FILES, NO_FORECAST, open_pair, run_fires, sentences, write_results

    console = Console()
    blowing, wet = Wind.parse(wind), Moisture.parse(moisture)
    require_files([out / name for name in FILES], overwrite)
    interpreter()
    pair = open_pair(landscape, site, before, since)
    row, col = ignition_cell(ignition, ignition_crs, pair.after)
    ignition_cell(ignition, ignition_crs, pair.before)
    scenario = FireScenario(row, col, blowing, wet, hours)
    with console.status("") as status:
        result = run_fires(pair, scenario, status.update)
    write_results(out, pair, scenario, result)
    rows = []
    for area in result.effect.areas():
        change = difference(area.before, area.after)
        rows.append((f"{area.hours:g}", number(area.before), number(area.after), change))
    title = f"hectares burned; {result.model}; {scenario.wind.described()}; {scenario.moisture.described()}"
    columns = (">hours", ">before", ">after", ">difference")
    print_table(console, title, columns, rows)
    for sentence in [*sentences(pair, result), NO_FORECAST]:
        console.print(sentence, highlight=False)
    slowest = f"{max(result.seconds):.1f} s for the slowest of {len(result.seconds)} fires"
    console.print(f"wrote {out / FILES[0]}; {slowest}", highlight=False)
