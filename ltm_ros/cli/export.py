"""`ltm export`: the fuel map of a recording or GeoTIFF, in any CRS."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def export(
    source: Annotated[Path, typer.Argument(help="Bag with a fuel_map topic, or a fuel map GeoTIFF.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="GeoTIFF to write.")],
    site: Annotated[Path | None, typer.Option("--site", help="Site file; needed for a bag.")] = None,
    crs: Annotated[
        str | None, typer.Option(help="Target CRS; EPSG:5070 gives LANDFIRE's grid. Default: the source's.")
    ] = None,
) -> None:
    """Write a fuel map as GeoTIFF; into another CRS by nearest cell, on a grid with edges at 15 mod 30."""
    from ltm_core.errors import ConfigError
    from ltm_core.fuel.fuel_map_io import read_fuel_map, resampled, write_fuel_map
    from ltm_core.site_io import load_site
    from ltm_core.vision.labels import LabelSet

    if source.suffix.lower() in (".tif", ".tiff"):
        classes, geometry = read_fuel_map(source)
        labels = LabelSet.load()
    else:
        if site is None:
            raise ConfigError("a bag's fuel map stands in its site's map frame: name the site file with --site")
        from ltm_ros.recorded_map import last_fuel_map

        config = load_site(site)
        classes, geometry, labels = last_fuel_map(source, config)
    if crs is not None:
        classes, geometry = resampled(classes, geometry, crs)
    write_fuel_map(out, classes, geometry, labels)
    typer.echo(f"wrote {out}: {geometry.width} x {geometry.height} cells of {geometry.resolution:g} m, {geometry.crs}")
