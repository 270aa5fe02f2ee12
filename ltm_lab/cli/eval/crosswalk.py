"""`ltm-lab eval crosswalk`: scores FBFM40 -> FBFM13 on fuel maps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_ros.cli.output import JsonFile

if TYPE_CHECKING:
    from ltm_core.fuel.prior import FuelPrior


def crosswalk(
    maps: Annotated[
        list[Path],
        typer.Argument(help="Files of FBFM40 codes; canopy cover and FBFM13 are taken from beside them, if there."),
    ],
    climate: Annotated[str, typer.Option(help="Fuel climate whose table is scored: dry or humid.")] = "dry",
    json_path: JsonFile = None,
) -> None:
    """Score how FBFM40 becomes FBFM13: whether grass, shrub and timber stay their own, and agreement with a map's own
    FBFM13, before and after the table was bound to the fuel type."""
    from rich.console import Console
    from rich.table import Table

    from ltm_lab.evaluation.fuel.crosswalk_score import score_crosswalk
    from ltm_ros.pages.figures_io import write_figures

    table = Table(
        title=f"FBFM40 to FBFM13, climate {climate}",
        caption="unbound table: each code's commonest partner, as it was; table: within the fuel type; its own pairs: "
        "with what the map itself shows; agreement: with the map's own FBFM13; east: in its eastern half",
    )
    for name in ("map", "way", "grass kept", "shrub kept", "timber kept", "agreement", "east"):
        table.add_column(name, justify="left" if name in ("map", "way") else "right")
    figures = []
    for path in maps:
        for score in score_crosswalk(_read(path), climate):
            shares = {**score.kept, "agreement": score.agreement, "east": score.east}
            cells = ["" if share is None or not share.of else f"{share.value:.2%}" for share in shares.values()]
            table.add_row(f"{path.parent.name}/{path.name}", score.way, *cells)
            values = {name: share.value if share is not None and share.of else None for name, share in shares.items()}
            figures.append({"map": str(path), "climate": climate, "way": score.way, **values})
        table.add_section()
    Console().print(table)
    if json_path is not None:
        write_figures(json_path, {"crosswalk": figures})


def _read(path: Path) -> FuelPrior:
    from ltm_core.base.errors import RasterError
    from ltm_core.fuel.prior import PriorConfig
    from ltm_core.fuel.prior_io import load_prior
    from ltm_core.geometry.grid import GridGeometry
    from ltm_core.raster.raster_io import open_raster

    with open_raster(path) as source:
        t = source.transform
        if source.crs is None or t.b or t.d or t.a <= 0 or t.e != -t.a:
            raise RasterError(f"{path}: a fuel map is north-up with square cells and a CRS")
        grid = GridGeometry(t.c, t.f, t.a, source.width, source.height, source.crs.to_wkt())
    return load_prior(PriorConfig(path=path.parent, fbfm40=path, unknown_codes="nodata", own_fbfm13="as_given"), grid)
