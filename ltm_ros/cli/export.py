"""`ltm export` and `ltm fire`: write fuel maps and terrain for other programs, and simulate a fire."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from ltm_core.base.errors import ConfigError
from ltm_core.base.number_text import difference, number
from ltm_core.fire.effect import FireScenario, Moisture, Wind, ignition_cell
from ltm_core.fire.pyretechnics import interpreter
from ltm_core.fuel.class_map import UNSEEN, read_fuel_map, snapped_grid, write_fuel_map
from ltm_core.fuel.export.companion_files_io import remove_item, style_owner, write_palette_style
from ltm_core.fuel.export.export_grid import GridTransfer
from ltm_core.fuel.export.provenance import software
from ltm_core.fuel.life_form import life_form_labels
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pipeline.site_surface import open_stored_surface
from ltm_core.site.site_io import load_site
from ltm_core.storage.disk_io import require_files, require_folder
from ltm_core.surface.surface_io import BANDS, write_export
from ltm_core.vision.labels import LabelSet
from ltm_ros.cli.output import Overwrite, print_table, say, working
from ltm_ros.fuel_map.export import export_site, sidecars
from ltm_ros.fuel_map.source import FuelSource
from ltm_ros.recordings.recorded_run import last_fuel_map

Format = Literal[
    "auto", "classes", "lcp", "landscape", "elmfire", "layers", "png", "change", "surface", "kmz"
]  # fmt: skip
Codes = Literal["fbfm40", "fbfm13"]

_TIFF: tuple[Format, ...] = ("classes", "landscape")
_BY_SUFFIX: dict[str, tuple[Format, ...]] = {
    ".tif": _TIFF, ".tiff": _TIFF, ".lcp": ("lcp",), ".kmz": ("kmz",), ".png": ("png", "change")
}  # fmt: skip
"""Formats of a suffix; the first one is written if none is requested."""
_OF_MODELS = ("landscape", "lcp", "elmfire")
_FOLDERS: tuple[Format, ...] = ("elmfire", "layers")


def export(
    source: Annotated[Path, Argument(help="Fuel map (store .ltm, bag or GeoTIFF), or terrain store (.sqlite).")],
    out: Annotated[Path, Option("--out", "-o", help="Output file, or folder for elmfire and layers.")],
    site: Annotated[Path | None, Option(help="Site file; required except for a GeoTIFF of classes.")] = None,
    crs: Annotated[str | None, Option(help="Target CRS; EPSG:5070: LANDFIRE's grid. Default: the source's.")] = None,
    format_: Annotated[
        Format,
        Option(
            "--format",
            help="Default: by the suffix of --out. classes: GeoTIFF of labels; lcp, landscape, elmfire: fire models; "
            "layers: folder of GeoTIFFs; png, change, kmz: images; a terrain store is written as change or surface.",
        ),
    ] = "auto",
    system: Annotated[Codes | None, Option(help="Fuel models of a landscape (also as .tif). Default: fbfm40.")] = None,
    as_of: Annotated[str | None, Option(help="Store only: date or time (UTC) of the map.")] = None,
    since: Annotated[str | None, Option(help="For change: earlier date. Default: the prior map.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a fuel map, optionally in another CRS (nearest cell, edges at 15 mod 30), or an updated terrain."""
    if not out.parent.is_dir():
        raise ConfigError(f"{out}: the folder {out.parent} does not exist; create it first")
    if source.suffix == ".sqlite":
        geometry = _export_terrain(source, out, site, format_, [crs, as_of, since, system], overwrite)
        _echo_written(out, format_, geometry)
        return
    if format_ == "surface":
        raise ConfigError(f"{source} is not a terrain store: surface needs a terrain.sqlite")
    kind = _kind_of(out, format_, system)
    if kind in _FOLDERS:
        require_folder(out)
        if out.is_dir() and any(out.iterdir()) and not overwrite:
            raise ConfigError(f"{out}: contains files already; give another folder, or --overwrite")
    else:
        require_files([out], overwrite)
    if since is not None and kind != "change":
        raise ConfigError("--since is the earlier date of a change image: give --format change")
    require_files(sidecars(out, kind), overwrite)
    if kind == "classes":
        geometry = _export_classes(source, out, site, crs, as_of)
        remove_item(out)
    else:
        if site is None:
            raise ConfigError(
                f"{kind} needs the terrain and the prior fuel map of a site: give the site file with --site"
            )
        with FuelSource.open(source, load_site(site)) as map_:
            geometry, notes = export_site(map_, out, crs, kind, system or "fbfm40", as_of, since)
        for note in notes:
            typer.echo(note)
    _echo_written(out, kind, geometry)
    if kind == "classes" and format_ == "auto":
        typer.echo(f"{out} has one band of life forms; for a fire model, give --format landscape")
    if owner := style_owner(out):
        typer.echo(f"{out.with_suffix('.qml')} is the style of {owner} and was kept; QGIS shows {out.name} with it")


def _kind_of(out: Path, requested: Format, system: Codes | None) -> Format:
    """Return the format to write. Raises ConfigError for a suffix of another format, and `--system` without use."""
    usual = _BY_SUFFIX.get(out.suffix.lower(), ())
    if requested == "auto" and not usual:
        raise ConfigError(f"{out}: its suffix belongs to no format; give --format, or one of {', '.join(_BY_SUFFIX)}")
    if usual and requested not in ("auto", *usual, *_FOLDERS):
        raise ConfigError(f"{out}: {out.suffix} is not written as {requested}; use {' or '.join(usual)}, or rename it")
    kind = requested if requested != "auto" else usual[0] if system is None else usual[-1]
    if system is not None and kind not in _OF_MODELS:
        raise ConfigError(f"{out}: --system {system} applies to landscapes only; give --format {', '.join(_OF_MODELS)}")
    return kind


def _echo_written(out: Path, kind: Format, g: GridGeometry) -> None:
    typer.echo(f"wrote {out} as {kind}: {g.width} x {g.height} cells of {g.resolution:g} m, {g.crs}")


def _export_terrain(
    source: Path, out: Path, site: Path | None, kind: Format, unfit: Sequence[str | None], overwrite: bool
) -> GridGeometry:
    """Write a terrain. `unfit`: given options that do not apply to a terrain."""
    if site is None:
        raise ConfigError(f"{source} holds differences from its site's terrain: give the site file with --site")
    if any(unfit):
        raise ConfigError(
            "a terrain is exported in its current state and CRS, without fuel: remove --crs, --as-of, --since, --system"
        )
    what = next((name for name in BANDS if name == kind), None)
    if what is None or out.suffix.lower() not in (".tif", ".tiff"):
        raise ConfigError(f"{out}: a terrain is written as GeoTIFF (.tif); give --format change or --format surface")
    require_files([out], overwrite)
    loaded = load_site(site)
    surface = open_stored_surface(source, loaded)
    geometry = loaded.in_crs(surface.reference.geometry)
    write_export(out, surface, what, geometry)
    return geometry


def _export_classes(source: Path, out: Path, site: Path | None, crs: str | None, as_of: str | None) -> GridGeometry:
    labels, tags = LabelSet.load(), {}
    if source.suffix.lower() in (".tif", ".tiff") and as_of is None:
        classes, geometry = read_fuel_map(source)
    else:
        if site is None:
            kind = "store" if source.suffix == ".ltm" else "bag"
            raise ConfigError(f"{source}: a {kind} does not contain the site's CRS; give the site file with --site")
        loaded = load_site(site)
        tags = {"site": loaded.name, "software": software()}
        if source.suffix == ".ltm" or as_of is not None:
            with FuelSource.open(source, loaded) as map_:
                layers = map_.at(as_of)
                classes, geometry, labels = layers.life_form, map_.geometry, map_.labels
                tags = map_.provenance(layers, None, as_of).tags()
        else:
            classes, geometry, labels = last_fuel_map(source, loaded)
    if crs is not None:
        source_grid, geometry = geometry, snapped_grid(geometry, crs)
        classes = GridTransfer(source_grid, geometry).layer(classes, UNSEEN)
    palette = life_form_labels(labels)
    write_fuel_map(out, classes, geometry, palette, tags)
    write_palette_style(out, list(zip(range(len(palette.names)), palette.names, palette.colors, strict=True)))
    return geometry


def fire(
    landscape: Annotated[Path, Argument(help="Fuel map store (.ltm, with --site), or landscape (LCP, GeoTIFF).")],
    ignition: Annotated[str, Option(help="Ignition point x,y in the landscape's CRS.")],
    wind: Annotated[str, Option("--wind", help="Wind speed in m/s at 10 m, and direction it comes from: 8,45.")],
    moisture: Annotated[
        str | None,
        Option(
            help="Fuel moisture: scenario (D2L2), or % of dead 1 h, 10 h, 100 h, live herbaceous, woody (6,7,8,60,90)."
        ),
    ] = None,
    hours: Annotated[float, Option(help="Duration of the fire in hours.")] = 6.0,
    site: Annotated[Path | None, Option(help="Site file of a store.")] = None,
    before: Annotated[Path | None, Option(help="For a landscape file: the earlier landscape.")] = None,
    since: Annotated[str | None, Option(help="For a store: date of the earlier map. Default: the prior.")] = None,
    ignition_crs: Annotated[str | None, Option(help="CRS of --ignition; EPSG:4326: degrees.")] = None,
    out: Annotated[Path, Option("--out", "-o", help="Folder for report, images, GeoTIFF and KMZ.")] = Path("out/fire"),
    overwrite: Overwrite = False,
) -> None:
    """Simulate a fire on the prior and on the updated map, and show the difference. This is no forecast."""
    from ltm_ros.fuel_map.fire import FILES, NO_FORECAST, open_pair, run_fires, sentences, write_results  # jinja2

    blowing, wet = Wind.parse(wind), Moisture.parse(moisture)
    require_files([out / name for name in FILES], overwrite)
    interpreter()
    pair = open_pair(landscape, site, before, since)
    row, col = ignition_cell(ignition, ignition_crs, pair.after)
    ignition_cell(ignition, ignition_crs, pair.before)
    scenario = FireScenario(row, col, blowing, wet, hours)
    with working("") as status:
        result = run_fires(pair, scenario, status.update)
    write_results(out, pair, scenario, result)
    rows = [
        (f"{area.hours:g}", number(area.before), number(area.after), difference(area.before, area.after))
        for area in result.effect.areas()
    ]
    title = f"hectares burned; {result.model}; {scenario.wind.described()}; {scenario.moisture.described()}"
    columns = (">hours", ">before", ">after", ">difference")
    print_table(title, columns, rows)
    for sentence in [*sentences(pair, result), NO_FORECAST]:
        say(sentence)
    slowest = f"{max(result.seconds):.1f} s for the slowest of {len(result.seconds)} fires"
    say(f"wrote {out / FILES[0]}; {slowest}")
