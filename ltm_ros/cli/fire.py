"""`ltm fire`: a fire on a fuel map as it was and as it is, by a fire model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import Overwrite, print_table


def fire(
    landscape: Annotated[
        Path,
        typer.Argument(help="Store of a site's fuel map (.ltm, with --site), or a landscape: LCP, GeoTIFF of 8 bands."),
    ],
    ignition: Annotated[str, typer.Option("--ignition", help="Where it starts: x,y in the landscape's CRS.")],
    wind: Annotated[
        str, typer.Option("--wind", help="m/s at 10 m, and the degrees from north that it blows from: 8,45.")
    ],
    moisture: Annotated[
        str | None,
        typer.Option(
            help="Of the fuel: a scenario of Scott and Burgan such as D2L2, or dead 1 h, 10 h, 100 h, live herbaceous, "
            "live woody in %: 6,7,8,60,90."
        ),
    ] = None,
    hours: Annotated[float, typer.Option(help="How long it runs.")] = 6.0,
    ensemble: Annotated[
        int, typer.Option(help="Of a store: also on so many landscapes drawn from what is known of its cells.", min=0)
    ] = 0,
    seed: Annotated[int, typer.Option(help="Of the draws.", min=0)] = 1,
    site: Annotated[Path | None, typer.Option("--site", help="Site file of a store.")] = None,
    before: Annotated[Path | None, typer.Option("--before", help="Of a file: the landscape as it was.")] = None,
    since: Annotated[
        str | None, typer.Option("--since", help="Of a store: as it was then. Default: before any camera looked.")
    ] = None,
    ignition_crs: Annotated[
        str | None, typer.Option("--ignition-crs", help="CRS of --ignition, such as EPSG:4326 for degrees.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for page, pictures, GeoTIFF, KMZ.")] = Path(
        "out/fire"
    ),
    overwrite: Overwrite = False,
) -> None:
    """Run a fire on a map as it was and as it is, and show what the update changes. Not a forecast."""
    from rich.console import Console

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
        result = run_fires(pair, scenario, ensemble, seed, status.update)
    write_results(out, pair, scenario, result)
    rows = []
    for area in result.effect.areas():
        drawn = "" if area.ensemble is None else f"{area.ensemble[0]:.0f} to {area.ensemble[2]:.0f}"
        change = f"{area.after - area.before:+.0f}"
        rows.append((f"{area.hours:g}", f"{area.before:.0f}", f"{area.after:.0f}", change, drawn))
    title = f"hectares burned; {result.model}; {scenario.wind.described()}; {scenario.moisture.described()}"
    columns = (">hours", ">as it was", ">as it is", ">difference", ">eight in ten draws")
    print_table(console, title, columns, rows)
    for sentence in [*sentences(pair, result), NO_FORECAST]:
        console.print(sentence, highlight=False)
    if result.effect.probability is not None:
        console.print(f"mean burn probability {result.effect.probability.mean():.2%} of all cells", highlight=False)
    slowest = f"{max(result.seconds):.1f} s for the slowest of {len(result.seconds)} fires"
    console.print(f"wrote {out / FILES[0]}; {slowest}", highlight=False)
